"""The tables between the comments of the pages."""

import re

from paper.__main__ import COMMANDS
from paper.blocks import BLOCK, BLOCKS, replace_blocks
from paper.rows import ROOT

PAGE = "Before.\n\n<!-- results: agents -->\n\n| old |\n\n<!-- end -->\n\nAfter.\n"
OTHERS = {"examples", "runtime", "dynamics", "ablations", "hard_further"}
"""Tables that are not made of the rows."""


def test_a_table_replaces_what_stands_between_its_comments() -> None:
    written = replace_blocks(PAGE, {"agents": "| new |\n"})
    assert written == PAGE.replace("old", "new")
    assert replace_blocks(written, {"agents": "| new |\n"}) == written
    assert replace_blocks(PAGE, {"success": "| new |\n"}) == PAGE


def test_every_table_has_its_place_in_one_page() -> None:
    pages = [ROOT / "README.md", *(ROOT / "docs").rglob("*.md")]
    named = [name for page in pages for name in BLOCK.findall(page.read_text())]
    assert set(named) == {*BLOCKS, *OTHERS}
    assert len(named) == len(set(named))


def test_the_commands_on_the_pages_exist() -> None:
    pages = [ROOT / "README.md", ROOT / "Makefile", *(ROOT / "docs").rglob("*.md")]
    text = "".join(page.read_text(encoding="utf-8") for page in pages)
    named = set(re.findall(r"python -m paper ([a-z]+)", text))
    assert {"run", "rows", "tables", "sweep"} <= named <= set(COMMANDS)
    for file in re.findall(r"paper/sweeps/\w+\.yaml", text):
        assert (ROOT / file).is_file()
