"""The examples, for a few episodes."""

import importlib
from pathlib import Path
from types import ModuleType

import cv2
import pandas as pd
import pytest

import modpush

EXAMPLES = Path(modpush.__file__).parents[1] / "examples"


@pytest.fixture
def example(monkeypatch: pytest.MonkeyPatch):
    def load(name: str) -> ModuleType:
        monkeypatch.syspath_prepend(str(EXAMPLES))
        return importlib.import_module(name)

    return load


def test_evaluate(example, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    evaluate = example("evaluate")
    config = evaluate.EvaluateConfig(
        policy=("corridor", "scripted"), sets=("smoke",), episodes=2, pictures=2, out=tmp_path
    )
    evaluate.main(config)
    printed = capsys.readouterr().out
    assert "smoke: beside the paper" in printed
    assert "corridor against scripted" in printed
    assert "paper_controller" in (tmp_path / "comparison" / "smoke.md").read_text()
    for policy in ("corridor", "scripted"):
        folder = tmp_path / policy / "smoke"
        rows = pd.read_csv(folder / "episodes.csv")
        assert sorted(rows["episode"]) == [0, 1]
        assert (folder / "failures.png").exists() == (not rows["success"].all())
        assert (folder / "successes.png").exists() == rows["success"].any()
        assert {p.stem for p in (folder / "videos").iterdir()} == set(rows["scene"])
        for ending in ("md", "tex", "csv"):
            assert "success" in (folder / f"table.{ending}").read_text()

    before = (tmp_path / "corridor" / "smoke" / "episodes.csv").read_bytes()
    evaluate.main(config)  # finds all done
    assert (tmp_path / "corridor" / "smoke" / "episodes.csv").read_bytes() == before


def test_all_stands_for_the_papers_sets(example) -> None:
    evaluate = example("evaluate")
    names = evaluate.EvaluateConfig(sets=("all",)).set_names
    assert names[0] == "free/small_cube"
    assert len(names) == 6


def test_every_method_is_known_by_its_name_and_settings(example, tmp_path: Path) -> None:
    methods = example("methods")
    found = [methods.get_method(name) for name in ("corridor", "corridor_faithful", "scripted")]
    assert len({method.label for method in found}) == 3
    assert found[1].make_policy().config.rules == "faithful"
    with pytest.raises(
        ValueError, match=r"no 'nobody', expected corridor, .*training run's folder"
    ):
        methods.get_method("nobody")


def test_demo(example, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    demo = example("demo")
    demo.main(
        demo.DemoConfig(
            policy=("corridor", "scripted"),
            scenes=("free", "slot"),
            episodes=1,
            out=tmp_path,
            rendered=False,
        )
    )
    assert "| slot | scripted |" in capsys.readouterr().out
    assert cv2.imread(str(tmp_path / "slot.png")) is not None
    capture = cv2.VideoCapture(str(tmp_path / "demo.mp4"))
    assert capture.get(cv2.CAP_PROP_FRAME_COUNT) > 20


@pytest.mark.parametrize(
    ("block", "printed", "folders"),
    [(0, "| mine | 4 |", ("mine",)), (1, "| success | 3 |", ("mine", "corridor"))],
)
def test_the_page_on_evaluation_runs(
    block: int,
    printed: str,
    folders: tuple[str, ...],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    page = (EXAMPLES.parent / "docs" / "evaluation.md").read_text()
    code = page.split("```python\n")[1 + block].split("```")[0]
    monkeypatch.chdir(tmp_path)
    exec(compile(code, "docs/evaluation.md", "exec"), {"__name__": "page"})
    assert printed in capsys.readouterr().out
    for folder in folders:
        assert (tmp_path / "runs" / folder / "episodes.csv").exists()
