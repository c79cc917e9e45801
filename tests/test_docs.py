"""What README and the pages in docs/ show runs, and what they name exists."""

import re
from pathlib import Path

import pytest
import torchrl  # noqa: F401  # its logger keeps the standard output of its first import

ROOT = Path(__file__).resolve().parents[1]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
BLOCK = re.compile(r"^(?P<skip><!-- not run: .+ -->\n+)?```python\n(?P<code>.*?)^```", re.S | re.M)
PRINTED = {
    "planners.md": ["tensor([True]) tensor([0.65", "[True]"],
    "evaluation.md": ["| mine | 4 |", "| success | 3 |"],
}
"""Parts of what a page's blocks print, in order."""


def python_blocks(page: Path) -> list[str]:
    """A page's Python blocks, each on its own lines of the page, for readable tracebacks."""
    text = page.read_text()
    return [
        "\n" * text[: match.start("code")].count("\n") + match["code"]
        for match in BLOCK.finditer(text)
        if match["skip"] is None
    ]


@pytest.mark.parametrize(
    "page", [page for page in PAGES if python_blocks(page)], ids=lambda page: page.name
)
def test_the_python_blocks_of_a_page_run_one_after_the_other(
    page: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    names = {"__name__": "page"}
    for block in python_blocks(page):
        exec(compile(block, page, "exec"), names)
    printed = capsys.readouterr().out
    for part in PRINTED.get(page.name, ()):
        assert part in printed
        printed = printed.partition(part)[2]


def test_blocks_that_are_not_run_say_why(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    page.write_text("```python\na = 1\n```\n<!-- not run: a day -->\n```python\nb = 2\n```\n")
    assert python_blocks(page) == ["\na = 1\n"]


def test_no_page_names_a_missing_target_or_file() -> None:
    makefile = (ROOT / "Makefile").read_text()
    named = set()
    for path in (*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md")):
        text = path.read_text()
        for target in re.findall(r"(?:`|^)make ([a-z-]+)", text, re.MULTILINE):
            assert re.search(rf"^{target}:", makefile, re.MULTILINE), (path.name, target)
            named.add(target)
        for script in re.findall(r"\b((?:examples|benchmarks|tools)/[\w/]+\.(?:py|sh))", text):
            assert (ROOT / script).is_file(), (path.name, script)
        for test in re.findall(r"\b(tests/[\w/]+\.py)", text):
            assert (ROOT / test).is_file(), (path.name, test)
    assert {"demo", "test"} <= named
