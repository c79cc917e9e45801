"""What the README shows runs."""

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
BLOCKS = re.findall(r"```python\n(.*?)```", (ROOT / "README.md").read_text(), re.DOTALL)


@pytest.mark.parametrize("index", range(len(BLOCKS)))
def test_python_blocks_of_the_readme(index, tmp_path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    exec(compile(BLOCKS[index], f"README block {index}", "exec"), {"__name__": "readme"})


def test_there_is_something_to_run() -> None:
    assert BLOCKS


@pytest.mark.parametrize(
    "target", ["setup", "demo", "test", "test-slow", "check", "bench", "renderer"]
)
def test_make_targets_named_in_the_docs_exist(target) -> None:
    makefile = (ROOT / "Makefile").read_text()
    assert re.search(rf"^{target}:", makefile, re.MULTILINE)


def test_no_doc_names_a_missing_target_or_file() -> None:
    makefile = (ROOT / "Makefile").read_text()
    for path in (*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md")):
        text = path.read_text()
        for target in re.findall(r"`make ([a-z-]+)", text):
            assert re.search(rf"^{target}:", makefile, re.MULTILINE), (path.name, target)
        for script in re.findall(r"\b((?:examples|benchmarks|tools)/[\w/]+\.(?:py|sh))", text):
            assert (ROOT / script).is_file(), (path.name, script)
