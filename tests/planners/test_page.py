"""What the page on planners shows runs."""

import re
from pathlib import Path

import pytest

PAGE = Path(__file__).resolve().parents[2] / "docs" / "planners.md"
BLOCKS = re.findall(r"```python\n(.*?)```", PAGE.read_text(), re.DOTALL)


@pytest.mark.parametrize(
    ("index", "printed"), [(0, "tensor([True]) tensor([0.65"), (1, "[True]")], ids=["call", "env"]
)
def test_the_page_on_planners_runs(index, printed, capsys) -> None:
    exec(compile(BLOCKS[index], PAGE.name, "exec"), {"__name__": "page"})
    assert printed in capsys.readouterr().out
