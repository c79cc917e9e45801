"""The tables that `benchmarks/results_tables.py` writes into the pages."""

import importlib.util
from pathlib import Path
from types import ModuleType

import pandas as pd
import pytest

ROOT = Path(__file__).resolve().parents[1]


def load() -> ModuleType:
    spec = importlib.util.spec_from_file_location(
        "results_tables", ROOT / "benchmarks" / "results_tables.py"
    )
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


tables = load()
ROWS = pd.DataFrame(
    {
        "success": [True, True, False, True],
        "contact_rate_at_end": [0.9, 0.8, 0.0, 1.0],
        "collision_rate_object_at_end": [0.0, 0.03, 0.9, 0.0],
        "collision_rate": 0.5,
        "spl_authors_agent": [1.0, 0.8, 0.0, 0.6],
    }
)


def test_a_cell_has_both_agents_with_their_differences_and_the_printed_figure() -> None:
    # Success 3 of 4, SPL 2.4 / 4; over the solved ones contact 2.7 / 3 and collisions 0.03 / 3.
    def cell(metric: str, name: str) -> str:
        return tables._beside(metric, name, {"any_object": ROWS, "small_cube": ROWS})

    ours = "0.750 (−0.230) / 0.750 (−0.230) / 0.980"
    assert cell("success", "obstacles/small_cube") == ours
    assert cell("contact_rate", "hard200/small_cube").endswith("0.900 (−0.077) / 0.977 of 50")
    assert cell("collision_rate", "obstacles/small_cube").startswith("0.010 (+0.002) / ")
    assert cell("collision_rate", "free/small_cube") == "0.010 / 0.010 / –"
    assert cell("spl", "obstacles/fragment").endswith("/ 0.710, retrained 0.830")


def test_a_table_replaces_what_stands_between_its_comments(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(tables.BLOCKS, "agents", lambda: "| new |\n")
    page = "Before.\n\n<!-- results: agents -->\n\n| old |\n\n<!-- end -->\n\nAfter.\n"
    written = tables.rewrite(page)
    assert written == page.replace("old", "new")
    assert tables.rewrite(written) == written
    with pytest.raises(ValueError, match=r"results: must be one of .*'agents'.*, got 'nothing'"):
        tables.rewrite(page.replace("agents", "nothing"))


def test_every_table_has_its_place_in_a_page() -> None:
    text = "".join((ROOT / page).read_text() for page in tables.PAGES)
    assert all(f"<!-- results: {name} -->" in text for name in tables.BLOCKS)
    assert text.count("<!-- results: ") == text.count("<!-- end -->") == len(tables.BLOCKS)
