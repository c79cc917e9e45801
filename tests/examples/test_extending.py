"""Every kind of part of one's own, trained with for some steps by the scripts in `examples/extending`."""

from pathlib import Path

import pytest

from modpush.mdp import PushObservation
from modpush.recipes import make_push_env
from modpush.training import TRAIN_PRESETS
from tests.examples import EXAMPLES, load_example
from tests.training.conftest import SHORT, SMOKE


@pytest.fixture(autouse=True)
def short_runs(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(TRAIN_PRESETS, "smoke", SHORT)


def run(name: str, folder: Path):
    return load_example(f"extending.{name}").main(folder / "run")


def test_encoder(tmp_path: Path) -> None:
    assert run("encoder", tmp_path) == {"latent": 16, "updates": 4}


def test_planner(tmp_path: Path) -> None:
    assert 1.0 < run("planner", tmp_path) <= 2**0.5 + 1e-3


def test_observation_entry(tmp_path: Path) -> None:
    assert run("observation_entry", tmp_path) == ["latent", "ee_position", "goal", "contacts"]


def test_reward_term(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(TRAIN_PRESETS, "smoke", SMOKE)
    # A random action has a squared length of 1 on average, a weight of 0.2 and a scale of 0.1, for
    # 20 steps: -0.4 beside what else the reward holds.
    assert run("reward_term", tmp_path) < -0.3


def test_scene(tmp_path: Path) -> None:
    assert run("scene", tmp_path) == ["extending.scene:gate"]


def test_pushed_object(tmp_path: Path) -> None:
    result = run("pushed_object", tmp_path)
    assert result["symmetry"] == result["observed_symmetry"] == 1
    assert result["observed_radius"] == pytest.approx(result["radius"])
    assert 0.045 < result["radius"] < 0.065


def test_depth_camera(tmp_path: Path) -> None:
    # The mean of a Gaussian's absolute value is 0.8 of its deviation, half of it cut off at the table.
    assert run("depth_camera", tmp_path) == pytest.approx(0.4 * 0.0022, rel=0.1)


def test_similarity(tmp_path: Path) -> None:
    assert -0.5 < run("similarity", tmp_path) <= 0.0
    env = make_push_env(SHORT.env)
    env.reset()
    observed = next(t for t in env.transform if isinstance(t, PushObservation))
    column = load_example("extending.similarity").GOAL_DISTANCE
    assert observed.columns["goal_distance"] == slice(column, column + 1)
    env.close()


def test_loss(tmp_path: Path) -> None:
    assert run("loss", tmp_path) == 4


def test_every_example_of_a_part_is_tested_and_short() -> None:
    scripts = sorted((EXAMPLES / "extending").glob("*.py"))
    tested = {name.removeprefix("test_") for name in globals() if name.startswith("test_")}
    assert {script.stem for script in scripts} <= tested
    for script in scripts:
        assert len(script.read_text().splitlines()) < 80, script.name


def test_robot() -> None:
    assert load_example("extending.robot").main(4) == 1.0
