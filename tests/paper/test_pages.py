"""Pages for which episodes are run: other dynamics, pictures, computing times."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from modpush.envs.scenes.conditions import EpisodeConditions
from modpush.evaluation import EvaluationSet, load_set
from modpush.recipes.methods import get_method
from paper import dynamics, examples
from paper.dynamics import QUANTITIES, Change, measure_dynamics
from paper.examples import choose_examples, write_examples
from paper.measure import Running
from paper.runtime import measure_runtime


@pytest.mark.slow
def test_the_pages_are_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for module in (dynamics, examples):
        monkeypatch.setattr(module, "ROWS", tmp_path / "rows.parquet")
    running = Running(folder=tmp_path, progress=False)
    text = measure_dynamics(running, "small_cube", 1, 3)
    assert text.count("(training)") == len(QUANTITIES)
    assert "| command | `python -m paper dynamics` |" in text
    assert "obstacles/small_cube" in write_examples(running, "small_cube", 5)
    assert "action prediction of the network" in measure_runtime("small_cube", 3)
    for name in ("dynamics", "examples"):
        assert (tmp_path / f"{name}.png").stat().st_size > 10_000


@pytest.mark.parametrize("quantity", QUANTITIES)
def test_a_change_reaches_scenario_or_environment(quantity: str) -> None:
    value = QUANTITIES[quantity].values[-1]
    assert QUANTITIES[quantity].nominal in QUANTITIES[quantity].values
    change = Change(quantity=quantity, value=value)
    nominal = Change(quantity=quantity, value=QUANTITIES[quantity].nominal)
    assert (change.name, nominal.name) == (f"{quantity}_{value:g}", "nominal")
    plain, changed = nominal.scenario(1, 0), change.scenario(1, 0)
    if quantity in ("mass", "friction"):
        assert getattr(changed.dynamics, quantity) == value
    elif quantity == "center_of_mass":
        assert np.hypot(*changed.dynamics.center_of_mass) == pytest.approx(value)
    elif quantity == "size":
        assert change.item.radius == pytest.approx(1.6 * nominal.item.radius)
        assert change.item.mass == nominal.item.mass
    elif quantity == "tip_height":
        assert change.item.tool_height == value
    if quantity != "size":
        assert changed.object_pose == plain.object_pose
        assert changed.goal_position == plain.goal_position
        assert changed.obstacles == plain.obstacles


@pytest.mark.parametrize("quantity", ["size", "tip_height", "control_freq", "depth_noise"])
def test_the_agent_acts_in_a_changed_environment(quantity: str) -> None:
    change = Change(quantity=quantity, value=QUANTITIES[quantity].values[-1])
    method = get_method("small_cube")
    env = change.make_env(1, method, EpisodeConditions())
    try:
        td = env.reset(scenarios=[change.scenario(1, 0)])
        td = env.step(method.make_policy()(td))
        assert td["next", "observation"].isfinite().all()
    finally:
        env.close()


def test_examples_are_chosen_by_the_rule() -> None:
    scenarios = load_set("obstacles/small_cube").scenarios[:5]
    straight = [np.hypot(*np.subtract(s.object_pose[:2], s.goal_position)) for s in scenarios]
    agent = pd.DataFrame(
        {
            "episode": range(5),
            "scene": ["a", "a", "a", "b", "b"],
            "success": [True, True, True, True, False],
            # Nothing stands in the way of 0 and 4.
            "shortest_length": np.multiply(straight, [1.0, 1.2, 1.2, 1.2, 1.2]),
            "path_length": [0.5, 0.5, 0.5, 0.5, 0.5],
        }
    )
    controller = agent.assign(success=[True, False, True, True, True])
    controller["path_length"] = [0.9, 0.9, 0.5, 0.6, 0.9]
    # Of family a: 1 is not solved by both, so 2; of b: 3. Both solved 0, where 0.4 m were saved.
    episodes = EvaluationSet(name="five", scenarios=scenarios)
    assert choose_examples(agent, controller, episodes) == [2, 3, 0]
