"""Conditions that every engine meets, by the boundary alone."""

import math
from collections.abc import Iterator

import numpy as np
import pytest
import torch

from modpush.envs import OBJECTS, Obstacle
from modpush.envs.engines.base import SceneSpec
from modpush.envs.engines.sapien.engine import SapienEngine
from modpush.envs.robot.ur5_2f85 import TOOLS
from modpush.envs.scene_batch import SceneBatch
from modpush.envs.simulation_config import SimulationConfig
from tests.envs.engines.sapien.test_agent import scenario

AHEAD, STILL = torch.tensor([[1.0, 0.0, 0.0]]), torch.zeros(1, 3)
BEHIND = (0.40, 0.0, math.pi / 2)  # the tool's wide side towards +x
WALL = Obstacle((0.40, 0.06, 0.06), (0.62, 0.0, math.pi / 2))


@pytest.fixture(scope="module", params=[SapienEngine], ids=["sapien"])
def batch(request: pytest.FixtureRequest) -> Iterator[SceneBatch]:
    spec = SceneSpec(
        tool=TOOLS["2f85"],
        objects=tuple(OBJECTS.values()),
        sim_freq=request.param.default_sim_freq,
        control_freq=15,
    )
    batch = SceneBatch(1, request.param.build, spec, None, False)
    yield batch
    batch.close()


@pytest.mark.parametrize("name", sorted(OBJECTS))
def test_an_object_rests_on_the_table_and_is_pushed_without_a_gap(batch, name) -> None:
    (engine,) = batch.engines
    batch.start([0], [scenario(BEHIND, (0.50, 0.0, 0.0), name=name)])
    for _ in range(8):
        batch.step(STILL)
    assert engine.object_transform()[2] == pytest.approx(OBJECTS[name].height / 2, abs=1e-3)
    assert engine.gaps()["object_table"] > -1e-3
    touched = []
    for _ in range(12):
        batch.step(AHEAD)
        touched.append(bool(batch.measure().contacts[0, 0]))
        assert touched[-1] == (engine.gaps()["robot_object"] <= 1e-3) or not touched[-1]
    first = touched.index(True)
    assert all(touched[first:])
    assert engine.object_transform()[0] > 0.52


def test_a_squeezed_object_hardly_sinks_into_wall_or_tool(batch) -> None:
    (engine,) = batch.engines
    batch.start([0], [scenario(BEHIND, (0.50, 0.0, 0.0), obstacles=(WALL,))])
    for _ in range(20):
        batch.step(AHEAD)
    gaps = engine.gaps()
    assert batch.measure().contacts[0, :2].all()
    assert min(gaps["robot_object"], gaps["object_obstacle"], gaps["object_table"]) > -1.5e-3
    assert engine.obstacle_transforms()[0, :2] == pytest.approx([0.62, 0.0], abs=1e-6)


def test_the_tip_follows_within_2_mm(batch) -> None:
    batch.start([0], [scenario((0.45, -0.1, 0.0), (0.3, 0.3, 0.0))])
    rng = np.random.default_rng(0)
    for _ in range(30):
        batch.step(torch.from_numpy(rng.choice([-1.0, 1.0], (1, 3))))
        measured = batch.measure().ee_pose - batch._target
        assert np.abs(measured[0, :2]).max() < 2e-3


def test_a_state_continues_to_the_last_bit_whatever_was_before(batch) -> None:
    (engine,) = batch.engines
    start = scenario(BEHIND, (0.50, 0.0, 0.3), obstacles=(WALL,))
    batch.start([0], [start])
    for _ in range(6):
        batch.step(AHEAD)
    state, ends = batch.get_state(0), []
    for _ in range(2):
        batch.set_state(0, state)
        assert (engine.pack() == state.physics).all()
        for _ in range(6):
            batch.step(AHEAD)
        ends.append(engine.pack())
        batch.start([0], [scenario((0.6, 0.2, 0.0), (0.3, -0.2, 0.0), name="fragment")])
        batch.step(AHEAD)
    np.testing.assert_array_equal(*ends)


def test_an_object_that_was_not_built_is_refused(batch) -> None:
    with pytest.raises(ValueError, match="'egg' was not loaded, expected one of"):
        batch.start([0], [scenario(BEHIND, name="egg")])


def test_the_default_rate_is_that_of_sapien() -> None:
    assert SimulationConfig().sim_freq == SapienEngine.default_sim_freq
