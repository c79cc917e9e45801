"""Conditions that every engine meets."""

import math
from collections.abc import Iterator, Sequence

import numpy as np
import pytest
import torch

from modpush.envs import OBJECTS, Obstacle, Patrol
from modpush.envs.engines.base import ENGINES, Engine, SceneSpec, find_engine
from modpush.envs.robot.named import ROBOTS, TOOLS
from modpush.envs.scene_batch import SceneBatch
from modpush.envs.scenes.objects import PushedObject, random_object
from modpush.envs.scenes.scenario import Dynamics
from tests.envs.engines.sapien.test_agent import scenario

AHEAD, STILL = torch.tensor([[1.0, 0.0, 0.0]]), torch.zeros(1, 3)
BEHIND = (0.40, 0.0, math.pi / 2)  # the tool's wide side towards +x
WALL = Obstacle((0.40, 0.06, 0.06), (0.62, 0.0, math.pi / 2))
WALL_FAR = Obstacle((0.10, 0.06, 0.06), (0.45, 0.38, 0.0))
PATROL = Obstacle(
    (0.20, 0.06, 0.06), (0.45, 0.0, math.pi / 2), Patrol(velocity=(0.1, 0.0), ahead=0.2, behind=0.1)
)
ASIDE = (0.30, -0.30, 0.0)  # the tool, out of its way
RANDOM = {item.name: item for item in map(random_object, (0, 1, 2))}
KINDS = {**OBJECTS, **RANDOM}
GRAVITY = 9.81


@pytest.fixture(scope="module", params=sorted(ENGINES))
def engine_name(request: pytest.FixtureRequest) -> str:
    return request.param


def make_batch(
    engine: str, num_envs: int = 1, robot: str = "ur5", tool: str = "2f85", **changes: bool
) -> SceneBatch:
    spec = SceneSpec(
        robot=ROBOTS[robot],
        tool=TOOLS[tool],
        objects=tuple(KINDS.values()),
        sim_freq=ENGINES[engine].sim_freq,
        control_freq=15,
        **changes,
    )
    return SceneBatch(num_envs, find_engine(engine), spec, None, False)


@pytest.fixture(scope="module")
def batch(engine_name) -> Iterator[SceneBatch]:
    batch = make_batch(engine_name)
    yield batch
    batch.close()


@pytest.fixture(scope="module")
def rod(engine_name) -> Iterator[SceneBatch]:
    batch = make_batch(engine_name, tool="rod")
    yield batch
    batch.close()


@pytest.fixture(scope="module")
def movable(engine_name) -> Iterator[SceneBatch]:
    batch = make_batch(engine_name, dynamic_obstacles=True)
    yield batch
    batch.close()


def kick(engine: Engine, linear: Sequence[float], angular: Sequence[float]) -> None:
    """Give the pushed object velocities [m/s, rad/s], which no engine has at a reset."""
    if engine.name == "sapien":
        engine._pushed_body.linear_velocity, engine._pushed_body.angular_velocity = linear, angular
    else:
        engine._data.qvel[6:12] = [*linear, *angular]


def yaw_of(engine: Engine) -> float:
    *_, w, _, _, z = engine.object_transform()
    return 2 * math.atan2(z, w)


def random_pushes(batch: SceneBatch, steps: int, seed: int = 0) -> None:
    rng = np.random.default_rng(seed)
    for _ in range(steps):
        action = rng.uniform(-1, 1, (1, 3)) + np.array([0.7, 0.0, 0.0])
        batch.step(torch.from_numpy(action).expand(batch.num_envs, 3))


@pytest.mark.parametrize("name", sorted(KINDS))
def test_an_object_rests_on_the_table_and_is_pushed_without_a_gap(batch, name) -> None:
    (engine,) = batch.engines
    batch.start([0], [scenario(BEHIND, (0.50, 0.0, 0.0), name=name)])
    for _ in range(8):
        batch.step(STILL)
    assert engine.object_transform()[2] == pytest.approx(KINDS[name].height / 2, abs=1e-4)
    assert engine.gaps()["object_table"] > -1e-4
    touched = []
    for _ in range(12):
        batch.step(AHEAD)
        touched.append(bool(batch.measure().contacts[0, 0]))
        assert touched[-1] == (engine.gaps()["robot_object"] <= 1e-3) or not touched[-1]
        assert min(engine.gaps().values()) > -1e-3
    first = touched.index(True)
    assert all(touched[first:])
    assert engine.object_transform()[0] > 0.52


def test_the_rod_pushes_without_a_gap(rod) -> None:
    rod.start([0], [scenario(BEHIND, (0.50, 0.0, 0.0))])
    contacts = []
    for _ in range(14):
        rod.step(AHEAD)
        contacts.append(bool(rod.measure().contacts[0, 0]))
    assert contacts == sorted(contacts)
    assert rod.engines[0].object_transform()[0] > 0.55


@pytest.mark.parametrize("name", ["small_cube", "small_cylinder", "fragment"])
def test_a_kicked_object_slides_and_turns_as_friction_says(batch, name) -> None:
    (engine,) = batch.engines
    batch.start([0], [scenario((0.45, -0.3, 0.0), (0.4, 0.1, 0.0), name=name)])
    start = engine.object_transform()
    kick(engine, (0.5, 0.0, 0.0), (0.0, 0.0, 0.0))
    for _ in range(8):
        batch.step(STILL)
    x, y, *_ = engine.object_transform()
    assert x - start[0] == pytest.approx(0.5**2 / (2 * 0.5 * GRAVITY), abs=2.1e-3)
    assert y == pytest.approx(0.1, abs=1e-3)
    before = yaw_of(engine)
    kick(engine, (0.0, 0.0, 0.0), (0.0, 0.0, 6.0))
    for _ in range(8):
        batch.step(STILL)
    assert 1.0 < math.degrees(yaw_of(engine) - before) < 5.0


def test_drawn_mass_friction_and_centre_of_mass_act(batch) -> None:
    (engine,) = batch.engines

    def slide(**dynamics) -> tuple[float, float]:
        """Way [m] and turn [rad] after a kick."""
        start = scenario((0.45, -0.3, 0.0), (0.4, 0.1, 0.0), dynamics=Dynamics(**dynamics))
        batch.start([0], [start])
        kick(engine, (0.5, 0.0, 0.0), (0.0, 0.0, 0.0))
        for _ in range(10):
            batch.step(STILL)
        return engine.object_transform()[0] - 0.4, yaw_of(engine)

    way, turn = slide()
    assert abs(turn) < 0.02
    # Friction is the mean of object and table: 0.35 instead of 0.5.
    assert slide(friction=0.2)[0] == pytest.approx(way * 0.5 / 0.35, rel=0.06)
    assert slide(mass=5.0)[0] == pytest.approx(way, rel=0.02)
    x = 0.5
    batch.start([0], [scenario((x - 0.1, 0.0, math.pi / 2), (x, 0.0, 0.0))])
    for _ in range(10):
        batch.step(AHEAD)
    straight = yaw_of(engine)
    dynamics = Dynamics(center_of_mass=(0.0, 0.015))
    batch.start([0], [scenario((x - 0.1, 0.012, 0.0), (x, 0.0, 0.0), dynamics=dynamics)])
    for _ in range(10):
        batch.step(AHEAD)
    beside = yaw_of(engine)
    batch.start([0], [scenario((x - 0.1, 0.012, 0.0), (x, 0.0, 0.0))])
    for _ in range(10):
        batch.step(AHEAD)
    assert abs(straight) < 0.1
    assert abs(beside - yaw_of(engine)) > 0.05


def turn_when_pushed(batch: SceneBatch, shift: float, beside: float) -> float:
    """Turn [deg] of a box, its long side across, that is slowly pushed ahead by 8 cm.

    Args:
        batch: A scene with the rod.
        shift: Of the centre of mass to the left, along the long side [m].
        beside: By how much the push passes the box's middle on the left [m].
    """
    dynamics = Dynamics(center_of_mass=(shift, 0.0))
    tool, box = (0.405, beside, 0.0), (0.45, 0.0, math.pi / 2)
    batch.start([0], [scenario(tool, box, name="box", dynamics=dynamics)])
    for _ in range(22):
        batch.step(0.2 * AHEAD)
    return math.degrees(yaw_of(batch.engines[0])) - 90


@pytest.mark.parametrize("side", [-1, 1])
def test_a_pushed_object_turns_about_its_centre_of_mass(rod, side) -> None:
    quarter = side * 0.025
    # The side with the centre of mass stays behind: to the left of the push, the box turns left.
    assert 25 < side * turn_when_pushed(rod, quarter, 0.0) < 60
    assert abs(turn_when_pushed(rod, quarter, quarter)) < 8
    assert side * turn_when_pushed(rod, 0.0, quarter) < -20
    assert abs(turn_when_pushed(rod, 0.0, 0.0)) < 1


@pytest.mark.parametrize("name", ["box", "small_cylinder", "fragment"])
def test_an_object_with_a_shifted_centre_of_mass_stands_as_any_other(batch, name) -> None:
    (engine,) = batch.engines
    shifted = Dynamics(center_of_mass=(0.4 * KINDS[name].inscribed_radius, 0.0))
    start = scenario(BEHIND, (0.50, 0.0, 0.0), name=name, dynamics=shifted)
    batch.start([0], [start])
    for _ in range(30):
        batch.step(STILL)
    assert engine.object_transform()[:3] == pytest.approx(
        [0.50, 0.0, KINDS[name].height / 2], abs=2e-4
    )
    random_pushes(batch, 15)
    first, even = engine.pack(), scenario(BEHIND, (0.50, 0.0, 0.0), name=name)
    batch.start([0], [even])
    random_pushes(batch, 15)
    after_shifted = engine.pack()
    batch.start([0], [start])
    for _ in range(30):
        batch.step(STILL)
    random_pushes(batch, 15)
    np.testing.assert_array_equal(engine.pack(), first)
    other = make_batch(engine.name)  # which has never had another one
    other.start([0], [even])
    random_pushes(other, 15)
    np.testing.assert_array_equal(other.engines[0].pack(), after_shifted)
    other.close()


def test_a_squeezed_object_hardly_sinks_into_wall_or_tool(batch) -> None:
    (engine,) = batch.engines
    batch.start([0], [scenario(BEHIND, (0.50, 0.0, 0.0), obstacles=(WALL,))])
    for _ in range(20):
        batch.step(AHEAD)
    gaps = engine.gaps()
    assert batch.measure().contacts[0, :2].all()
    assert min(gaps["robot_object"], gaps["object_obstacle"], gaps["object_table"]) > -1.5e-3
    assert engine.obstacle_transforms()[0, :2] == pytest.approx([0.62, 0.0], abs=1e-6)


def test_a_tool_that_meets_an_obstacle_is_stopped_and_reported(batch) -> None:
    batch.start([0], [scenario((0.50, 0.0, math.pi / 2), (0.3, 0.3, 0.0), obstacles=(WALL,))])
    assert not batch.measure().contacts.any()
    for _ in range(12):
        batch.step(AHEAD)
    measured = batch.measure()
    assert measured.contacts[0].tolist() == [False, False, True] * 2
    assert measured.ee_pose[0, 0] < 0.60


def test_only_movable_obstacles_are_pushed_away(movable) -> None:
    block = Obstacle((0.06, 0.06, 0.06), (0.58, 0.0, 0.0))
    movable.start([0], [scenario(BEHIND, (0.50, 0.0, 0.0), obstacles=(block, WALL))])
    still = movable.engines[0].obstacle_transforms()
    assert still[:, 2] == pytest.approx(0.03, abs=1e-6)
    for _ in range(10):
        movable.step(AHEAD)
    moved = movable.obstacle_entries()["obstacle_displacement"][0]
    assert moved[0] > 0.02
    assert movable.measure().contacts[0, 1]


def test_the_tip_follows_within_2_mm(batch) -> None:
    batch.start([0], [scenario((0.45, -0.1, 0.0), (0.3, 0.3, 0.0))])
    rng = np.random.default_rng(0)
    for _ in range(60):
        batch.step(torch.from_numpy(rng.choice([-1.0, 1.0], (1, 3))))
        measured = batch.measure().ee_pose - batch._target
        assert np.linalg.norm(measured[0, :2]) < 2e-3
    height = batch.engines[0].link_transforms(("tip",))[0][2]
    assert height == pytest.approx(0.02, abs=1e-3)


@pytest.mark.parametrize(
    ("kind", "moving"),
    [(0, ()), (1, ()), (0, (PATROL,)), (1, (PATROL,))],
    ids=["fixed", "movable", "patrol", "both"],
)
def test_a_state_continues_to_the_last_bit_whatever_was_before(
    kind, moving, batch, movable
) -> None:
    batch = (batch, movable)[kind]
    (engine,) = batch.engines
    start = scenario(BEHIND, (0.50, 0.0, 0.3), obstacles=(*moving, WALL))
    batch.start([0], [start])
    for _ in range(6):
        batch.step(AHEAD)
    state, ends = batch.get_state(0), []
    places = engine.obstacle_transforms()
    assert type(state).from_dict(state.to_dict()).physics.tobytes() == state.physics.tobytes()
    for _ in range(2):
        batch.check_state(0, state)
        batch.set_state(0, state)
        assert (engine.pack() == state.physics).all()
        np.testing.assert_allclose(engine.obstacle_transforms(), places, atol=1e-7)
        for _ in range(6):
            batch.step(AHEAD)
        ends.append(engine.pack())
        batch.start([0], [scenario((0.6, 0.2, 0.0), (0.3, -0.2, 0.0), name="fragment")])
        batch.step(AHEAD)
    np.testing.assert_array_equal(*ends)


def test_an_episode_depends_neither_on_earlier_ones_nor_on_other_scenes(engine_name, batch) -> None:
    start = scenario(BEHIND, (0.50, 0.0, 0.3), name="fragment", obstacles=(WALL,))
    batch.start([0], [scenario((0.6, 0.2, 0.0), (0.3, -0.2, 0.0))])
    random_pushes(batch, 5, seed=1)
    batch.start([0], [start])
    random_pushes(batch, 20)
    alone = batch.engines[0].pack()
    three = make_batch(engine_name, num_envs=3)
    other = scenario((0.45, 0.0, 0.0), (0.55, 0.0, 0.0), name="small_cylinder")
    three.start([0, 1, 2], [other, start, other])
    random_pushes(three, 20)
    np.testing.assert_array_equal(three.engines[1].pack(), alone)
    three.close()


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (lambda x: x[:-3], r"physics must be float32 of shape \(\d+,\), got float32 of shape"),
        (lambda x: x.astype(np.float64), "physics must be float32 .* got float64"),
        (lambda x: x.tolist(), "physics must be float32 .* got list"),
        (lambda x: np.where(np.arange(len(x)) == 5, np.nan, x).astype(np.float32), "got nan"),
        (lambda x: np.full_like(x, 32639), "physics must be finite|quaternions in physics"),
        (lambda x: np.zeros_like(x), "quaternions in physics must be of length 1"),
    ],
)
def test_a_damaged_state_is_refused(batch, damage, message) -> None:
    (engine,) = batch.engines
    start = scenario(BEHIND, (0.50, 0.0, 0.0))
    batch.start([0], [start])
    packed = engine.pack()
    engine.check_packed(packed, start)
    with pytest.raises(ValueError, match=message):
        engine.check_packed(damage(packed), start)


def test_an_object_that_was_not_built_is_refused(batch) -> None:
    with pytest.raises(ValueError, match="'egg' was not loaded, expected one of"):
        batch.start([0], [scenario(BEHIND, name="egg")])


def test_the_links_are_where_the_urdf_has_them(batch) -> None:
    batch.start([0], [scenario((0.5, 0.1, 0.3))])
    (x, y, z, *_), (_, _, flange, *_) = batch.engines[0].link_transforms(("tip", "tool"))
    assert (x, y, z) == pytest.approx((0.5, 0.1, 0.02), abs=1e-4)
    assert flange - z == pytest.approx(TOOLS["2f85"].length, abs=1e-4)


def test_every_kind_of_solid_is_pushed() -> None:
    kinds = {part.kind for item in KINDS.values() for part in item.parts}
    assert kinds == {"box", "cylinder", "prism"}
    assert all(isinstance(item, PushedObject) for item in KINDS.values())


def test_an_obstacle_patrols_and_reverses_whatever_is_in_its_way(batch) -> None:
    (engine,) = batch.engines
    start = scenario(ASIDE, (0.53, 0.0, 0.0), obstacles=(WALL_FAR, PATROL))
    batch.start([0], [start])
    for step in range(1, 76):  # 2 s ahead, 3 s back
        batch.step(STILL)
        expected = 0.45 + (0.1 * step / 15 if step <= 30 else 0.2 - 0.1 * (step - 30) / 15)
        x, y, z, *_ = engine.obstacle_transforms()[1]
        assert (x, y, z) == pytest.approx((expected, 0.0, 0.03), abs=1e-6)
        if step == 30:
            assert batch.measure().contacts[0].tolist() == [False, True, False] * 2
            # Pushed by its front side, half of 6 cm and of the cube's 5 cm ahead, and not flung away.
            assert engine.object_transform()[0] == pytest.approx(0.65 + 0.055, abs=2e-3)
        assert min(engine.gaps().values()) > -1.5e-3
    assert engine.object_transform()[0] == pytest.approx(0.65 + 0.055, abs=2e-3)
    assert not batch.measure().contacts.any()
    assert engine.obstacle_transforms()[0, :2] == pytest.approx(WALL_FAR.pose[:2], abs=1e-6)


def test_a_moving_obstacle_that_meets_the_tool_is_reported_and_not_stopped(batch) -> None:
    batch.start([0], [scenario((0.53, 0.0, math.pi / 2), obstacles=(PATROL,))])
    for _ in range(20):
        batch.step(STILL)
    assert batch.measure().contacts[0].tolist() == [False, False, True] * 2
    place = batch.engines[0].obstacle_transforms()[0, 0]
    assert place == pytest.approx(0.45 + 0.1 * 20 / 15, abs=1e-6)


def test_a_moving_obstacle_pushes_a_movable_one_and_passes_through_a_fixed_one(
    batch, movable
) -> None:
    block = Obstacle((0.05, 0.05, 0.05), (0.53, 0.0, 0.0))
    for scenes, moved in ((batch, 0.0), (movable, 0.055)):
        scenes.start([0], [scenario(ASIDE, obstacles=(block, PATROL))])
        for _ in range(15):
            scenes.step(STILL)
        places = scenes.engines[0].obstacle_transforms()[:, 0]
        assert places[1] == pytest.approx(0.55, abs=1e-6)
        assert places[0] == pytest.approx(0.55 + moved if moved else 0.53, abs=2e-3)
