"""Obstacles in the arm: by the links' geometry, and by SAPIEN's own contacts."""

import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
import torch

from modpush.envs import PushEnv
from modpush.envs.robot.named import ROBOTS, TOOLS
from modpush.envs.scenes.arm_room import (
    MAX_HEIGHT,
    keep_out_radius,
    obstacle_near_arm,
    tool_half_extents,
    tool_touches,
)
from modpush.envs.scenes.layouts import SCENES, TIGHT_SCENES
from modpush.envs.scenes.objects import OBJECTS, get_object
from modpush.envs.scenes.obstacle import Obstacle
from modpush.envs.scenes.sampling import sample_scenario
from modpush.envs.scenes.scenario import Scenario, ScenarioConfig

UR5, GRIPPER = ROBOTS["ur5"], TOOLS["2f85"]
START = Scenario(
    scene="free",
    difficulty=0.0,
    obstacles=(),
    pushed_object="small_cube",
    object_pose=(0.6, 0.0, 0.0),
    goal_position=(0.5, 0.0),
    tool_pose=(0.4, 0.0, 0.0),
)


def surface(shape) -> np.ndarray:
    """Points on a cylinder's or capsule's surface in its link's frame, at most 2 cm apart, `[n, 3]`."""
    radius, half_length, _ = shape.size
    angle, up = np.meshgrid(np.linspace(0, 2 * np.pi, 49), np.linspace(-1, 1, 40))
    round_end = shape.kind == "capsule"
    along = up * (half_length + radius * round_end)
    beyond = np.maximum(np.abs(along) - half_length, 0.0)
    across = np.sqrt(np.maximum(radius**2 - beyond**2, 0.0))
    points = np.stack([across * np.cos(angle), across * np.sin(angle), along], -1).reshape(-1, 3)
    return points @ shape.rotation().T + shape.position


SHORT = replace(TOOLS["rod"], name="short", length=0.06)


@pytest.mark.parametrize("tool", [GRIPPER, SHORT], ids=["2f85", "short"])
@pytest.mark.parametrize("name", ROBOTS)
@pytest.mark.parametrize("height", [0.02, 0.06, 0.10, 0.12, MAX_HEIGHT])
def test_the_links_stay_within_the_reach_at_every_pose_of_the_tool(height, name, tool) -> None:
    """With a short tool the wrist comes down to the obstacles."""
    robot, farthest = ROBOTS[name], 0.0
    base = np.array(robot.base)
    rng = np.random.default_rng(0)
    distance, azimuth = rng.uniform(*robot.reach, 100), rng.uniform(-1.2, 1.2, 100)
    place = base[:2] + distance[:, None] * np.stack([np.cos(azimuth), np.sin(azimuth)], -1)
    low, high = np.array([0.08, -0.47]), np.array([0.87, 0.47])
    place = place[((place >= low) & (place <= high)).all(-1)]
    for tip_height in (0.0, 0.02, 0.05):
        flange = np.full(len(place), tip_height + tool.length)
        yaw = rng.uniform(-1.5, 1.5, len(place))
        pose = np.column_stack([place - base[:2], flange - base[2], yaw])
        joints, found = robot.inverse(pose, np.tile(robot.home, (len(pose), 1)))
        assert found.mean() > 0.9  # a joint of the Panda may be at its limit
        frames = robot.link_transforms(joints[found])
        for i, link in enumerate(robot.links):
            points = np.concatenate([surface(shape) for shape in link.shapes])
            x, y, z = np.moveaxis(
                points @ frames[:, i, :3, :3].swapaxes(-1, -2) + frames[:, i, None, :3, 3], -1, 0
            )
            out = np.hypot(x - base[0], y - base[1])
            farthest = max(farthest, out[(z < height) & (x >= base[0])].max(initial=0.0))
    assert farthest <= keep_out_radius(robot, tool, height)
    if height >= 0.12:  # hardly more than there is
        assert farthest > 0.7 * keep_out_radius(robot, tool, height)


POSES = [
    (r * math.cos(a), r * math.sin(a), 0.0)
    for r in (0.44, 0.55, 0.65)
    for a in np.radians([-70, -35, 0, 35, 55, 70])
    if abs(r * math.sin(a)) < 0.46 and r * math.cos(a) > 0.09
]
"""Poses of the tool in its workspace, to the sides, straight ahead, near and far."""


@pytest.fixture(scope="module")
def env() -> Iterator[PushEnv]:
    """Eight scenes for all tests, since each takes a third of a second to build."""
    env = PushEnv(8, depth=None, pushed_object=tuple(OBJECTS))
    yield env
    env.close()


def touched(env: PushEnv, scenarios: list[Scenario]) -> list[bool]:
    """Whether any link touches an obstacle when nothing is done, by SAPIEN's contacts."""
    found, size = [], env.batch_size[0]
    for first in range(0, len(scenarios), size):
        some = scenarios[first : first + size]
        td = env.reset(scenarios=[*some, *some[-1:] * (size - len(some))])
        after = env.step(td.set("action", torch.zeros(*env.batch_size, 3)))["next"]
        found += after["tool_obstacle_contact"].flatten().tolist()[: len(some)]
    return found


@pytest.mark.parametrize("height", [0.06, 0.10, MAX_HEIGHT])
def test_only_an_obstacle_within_the_reach_is_touched_by_the_simulated_arm(
    height: float, env: PushEnv, monkeypatch: pytest.MonkeyPatch
) -> None:
    def start(pose, near: float) -> Scenario:
        """A block in front of the robot, between the axis and where the tool is."""
        block = Obstacle((0.05, 0.05, height), (near + 0.025, -0.03, 0.0))
        away = math.copysign(0.2, -pose[1] or 1.0)
        return replace(START, obstacles=(block,), tool_pose=pose, object_pose=(0.7, away, 0.0))

    assert not any(
        touched(
            env,
            [start(pose, keep_out_radius(UR5, GRIPPER, height) + 0.002) for pose in POSES],
        )
    )
    for pose in POSES[:1]:
        with pytest.raises(ValueError, match=r"scenarios\[0\]: expected obstacles .* at least 0"):
            touched(env, [start(pose, 0.17)])
    monkeypatch.setattr("modpush.envs.arguments.check_arm_is_free", lambda *_: None)
    assert any(touched(env, [start(pose, 0.165) for pose in POSES]))


def test_an_arm_can_pass_over_no_obstacle_taller_than_the_tallest() -> None:
    tall = Obstacle((0.05, 0.05, MAX_HEIGHT + 0.01), (0.6, 0.2, 0.0))
    assert "heights up to 0.15 m" in str(obstacle_near_arm([tall], UR5, GRIPPER))
    with pytest.raises(ValueError, match=r"leaves the arm no room in 100 layouts: .* to 0.15 m"):
        PushEnv(1, depth=None, scene=lambda rng, difficulty: [tall]).reset()


def test_a_tool_is_wider_where_obstacles_reach_its_upper_part() -> None:
    """The gripper's linkage is 4.5 cm over the tip, its body 7.3 cm."""
    tool = TOOLS["2f85"]
    for tip_height, height, expected in (
        (0.02, 0.0, (0.032, 0.011)),
        (0.02, 0.06, (0.032, 0.011)),
        (0.0145, 0.06, (0.062, 0.0135)),  # over the fragment
        (0.02, 0.09, (0.062, 0.0135)),
        (0.02, 0.15, (0.062, 0.038)),
    ):
        assert tool_half_extents(tool, tip_height, height).tolist() == list(expected)
    assert tool_half_extents(TOOLS["rod"], 0.02, 0.15).tolist() == [0.01, 0.01]


def test_a_tool_s_upper_part_counts_where_an_obstacle_is_tall_enough() -> None:
    """The gripper's linkage, 6.2 cm to each side, begins 4.5 cm over its tip."""
    bar = Obstacle((0.3, 0.06, 0.06), (0.585, 0.0, math.pi / 2))  # from 5.5 cm beside the tool on
    for tip_height, touches in ((0.0145, True), (0.0152, False)):
        assert tool_touches((0.5, 0.0, 0.0), tip_height, [bar], GRIPPER) == touches
    assert not tool_touches((0.5, 0.0, math.pi / 2), 0.0145, [bar], GRIPPER)
    assert not tool_touches((0.5, 0.0, 0.0), 0.0145, [bar], TOOLS["rod"])
    assert tool_touches((0.555, 0.0, 0.0), 0.02, [bar], TOOLS["rod"])


def draw(scene: str, item: str, count: int) -> list[Scenario]:
    """Starts of as many episodes, but for distances at which a family has none of a large object."""
    circle = "inscribed" if scene in TIGHT_SCENES else "circumscribed"
    config = ScenarioConfig(
        scene=scene, pushed_object=item, path_inflation=circle, distance=(0.2, 0.35)
    )
    found = []
    for seed in range(count):
        try:
            found.append(sample_scenario(np.random.default_rng([seed, 17]), config))
        except ValueError as error:
            if scene != "maze_wide" or "no start" not in str(error):
                raise
    return found


def is_free(start: Scenario) -> bool:
    tip_height = get_object(start.pushed_object).tool_height
    touching = tool_touches(start.tool_pose, tip_height, start.obstacles, GRIPPER)
    return not touching and obstacle_near_arm(start.obstacles, UR5, GRIPPER) is None


@pytest.mark.parametrize("item", OBJECTS)
def test_no_drawn_episode_starts_with_the_arm_in_an_obstacle(item: str, env: PushEnv) -> None:
    scenes = [name for name in SCENES if name != "free"]
    scenes += TIGHT_SCENES if item == "small_cube" else ()
    starts = [start for scene in scenes for start in draw(scene, item, 6)[:4]]
    assert all(map(is_free, starts))
    assert not any(touched(env, starts))


@pytest.mark.slow
@pytest.mark.parametrize("item", OBJECTS)
@pytest.mark.parametrize("scene", sorted({*SCENES, *TIGHT_SCENES} - {"free"}))
def test_no_drawn_episode_of_many_starts_with_the_arm_in_an_obstacle(scene, item, env) -> None:
    if scene in TIGHT_SCENES and item != "small_cube":
        pytest.skip("only the small cube passes through these")
    starts = draw(scene, item, 2000)
    assert len(starts) > 1800
    assert all(map(is_free, starts))
    if item == "fragment":  # of it the tool is lowest
        assert not any(touched(env, starts[:160]))
