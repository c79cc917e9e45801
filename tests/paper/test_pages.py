"""Pages for which episodes are run: other dynamics, pictures, computing times."""

from pathlib import Path

import numpy as np
import pytest

from paper import dynamics, examples
from paper.dynamics import QUANTITIES, Change, measure_dynamics
from paper.examples import write_examples
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
