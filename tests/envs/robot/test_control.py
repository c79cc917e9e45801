import math
from dataclasses import replace

import numpy as np
import pytest

from modpush.envs.robot.control import MotionConfig, MotionPlanner, start_joints
from modpush.envs.robot.named import ROBOTS, TOOLS

CONFIG, HEIGHT, UR5 = MotionConfig(), 0.183, ROBOTS["ur5"]
PLANNERS = {name: MotionPlanner(robot, CONFIG, 8, 15.0) for name, robot in ROBOTS.items()}


def joints_at(tip, robot="ur5") -> np.ndarray:
    """Joints that hold the flange at a pose, without a tool."""
    base_x, base_y, base_z = ROBOTS[robot].base
    pose = np.array([[tip[0] - base_x, tip[1] - base_y, HEIGHT - base_z, tip[2]]])
    return ROBOTS[robot].inverse(pose, np.array([ROBOTS[robot].home]))[0][0]


def plan(action, target, tip=None, robot="ur5", planner=None):
    target = np.array([target])
    tip = target if tip is None else np.array([tip])
    joints = joints_at(tip[0], robot)[None]
    return (planner or PLANNERS[robot]).plan(
        np.array([action]), target, tip, np.array([HEIGHT]), joints
    )


def test_full_action_moves_by_one_step() -> None:
    motion = plan([1.0, -1.0, 1.0], [0.5, 0.1, 0.2])
    assert motion.target[0].tolist() == pytest.approx([0.52, 0.08, 0.25])
    assert motion.reachable.all()


def test_actions_beyond_one_are_clipped() -> None:
    far, one = plan([9.0, 0, 0], [0.5, 0, 0]), plan([1.0, 0, 0], [0.5, 0, 0])
    np.testing.assert_array_equal(far.target, one.target)


@pytest.mark.parametrize("robot", ROBOTS)
def test_the_flange_is_on_the_straight_way_at_the_knots(robot) -> None:
    target = (0.4, 0.1, 0.0)
    motion = plan([1.0, -0.5, 1.0], target, robot=robot)
    assert motion.reachable.all()
    # Four knots in eight substeps.
    x, y, z = ROBOTS[robot].link_transforms(motion.position[0, 1::2])[:, -1, :3, 3].T
    np.testing.assert_allclose(x, np.linspace(0.405, 0.42, 4), atol=1e-7)
    np.testing.assert_allclose(y, np.linspace(0.0975, 0.09, 4), atol=1e-7)
    np.testing.assert_allclose(z, HEIGHT, atol=1e-7)


def test_a_blocked_arm_does_not_wind_up() -> None:
    # Commanded 10 cm ahead of where the tip is: pulled back to 12 mm, then one step of 2 cm.
    motion = plan([1.0, 0.0, 0.0], [0.6, 0.0, 0.0], tip=[0.5, 0.0, 0.0])
    assert motion.target[0, 0] == pytest.approx(0.5 + 0.012 + 0.02)


def test_yaw_is_anchored_the_short_way_round() -> None:
    target = plan([0.0, 0.0, 0.0], [0.5, 0.0, math.pi + 0.05], tip=[0.5, 0.0, -math.pi]).target
    assert target[0, 2] == pytest.approx(math.pi + 0.05)


@pytest.mark.parametrize("robot", ROBOTS)
def test_targets_stay_in_the_workspace_and_in_the_ring_around_the_base(robot) -> None:
    (base_x, base_y, _), (least, most) = ROBOTS[robot].base, ROBOTS[robot].reach
    middle = (0.35, 0.0) if robot != "panda" else (0.45, 0.0)
    for direction in ((1.0, 0.0), (-1.0, 0.0), (0.9, 0.9), (-0.6, 0.9)):
        target = [*middle, 0.0]
        for _ in range(60):
            motion = plan([*direction, 0.0], target, robot=robot)
            assert motion.reachable.all() or robot == "panda"  # a joint may be at its limit
            target = motion.target[0].tolist()
            radius = math.hypot(target[0] - base_x, target[1] - base_y)
            assert least - 1e-9 <= radius <= most + 1e-9
        before = plan([*direction, 0.0], target, robot=robot).target[0]
        assert before.tolist() == pytest.approx(target, abs=1e-3)  # at the edge


def test_an_unreachable_pose_leaves_the_target_where_it_was() -> None:
    # Wound up to just short of the last joint's limit, one more turn has no solution.
    start = [0.5, 0.0, 2 * math.pi - math.pi / 2]
    for _ in range(200):
        motion = plan([0.0, 0.0, 1.0], start)
        if not motion.reachable.all():
            break
        start = motion.target[0].tolist()
    assert not motion.reachable.any()
    assert motion.target[0].tolist() == pytest.approx(start)
    assert (motion.position == motion.position[:, :1]).all()
    assert not motion.velocity.any()


@pytest.mark.parametrize("num_substeps", [8, 16, 6])
def test_ramps_pass_through_the_knots_at_constant_speed_between(num_substeps: int) -> None:
    planner = MotionPlanner(UR5, CONFIG, num_substeps, 15.0)
    motion = plan([1.0, 0.7, -1.0], [0.5, 0.0, 0.0], planner=planner)
    position, velocity = motion.position[0], motion.velocity[0]
    assert position.shape == velocity.shape == (num_substeps, 6)
    np.testing.assert_allclose(position[-1], joints_at(motion.target[0]), atol=1e-9)
    if num_substeps % 4 == 0:  # velocity is the position's own rate of change
        start = joints_at((0.5, 0.0, 0.0))
        moved = np.diff(np.concatenate([start[None], position]), axis=0) * (15.0 * num_substeps)
        np.testing.assert_allclose(velocity, moved, atol=1e-9)


def test_scenes_of_a_batch_are_planned_as_if_alone() -> None:
    rng, n = np.random.default_rng(0), 20
    given = [
        rng.uniform(-1.3, 1.3, (n, 3)),
        targets := rng.uniform((0.05, -0.5, -7), (0.95, 0.5, 5), (n, 3)),
        targets + rng.uniform(-0.02, 0.02, (n, 3)),
        rng.uniform(0.17, 0.19, n),
    ]
    given.append(np.array([joints_at(tip) for tip in given[2]]))
    together = PLANNERS["ur5"].plan(*given)
    assert 0 < together.reachable.sum() < n
    for i in range(n):
        alone = PLANNERS["ur5"].plan(*(values[i : i + 1] for values in given))
        for one, all_of_them in zip(alone, together, strict=True):
            np.testing.assert_array_equal(one[0], all_of_them[i])


@pytest.mark.parametrize(
    ("field", "value"), [("max_step", 0.0), ("num_knots", 0), ("low", (1.0, 0.0))]
)
def test_config_refuses_impossible_values(field, value) -> None:
    with pytest.raises(ValueError, match=field):
        MotionConfig(**{field: value})


def test_an_arm_whose_last_joint_cannot_turn_around_holds_a_tool_that_looks_the_same() -> None:
    panda, tool = ROBOTS["panda"], TOOLS["2f85"]
    for yaw in (3.0, -2.8, 0.4):
        flange = panda.link_transforms(start_joints(panda, tool, (0.5, 0.2, yaw), 0.02))[-1]
        held = math.atan2(flange[1, 0], flange[0, 0])
        assert math.cos(2 * (held - yaw)) == pytest.approx(1.0, abs=1e-6)
        assert abs(held) < 2.0


def test_a_jump_to_another_branch_is_no_motion() -> None:
    jumping = replace(UR5, solve=lambda pose, last: (last + 0.6, np.ones(len(pose), bool)))
    planner = MotionPlanner(jumping, CONFIG, 8, 15.0)
    motion = plan([1.0, 0.0, 0.0], [0.5, 0.0, 0.0], planner=planner)
    assert not motion.reachable.any()
    assert motion.target[0].tolist() == pytest.approx([0.5, 0.0, 0.0])


def test_at_the_limit_of_its_last_joint_an_arm_still_moves_where_it_is_told() -> None:
    # Wound up to short of the limit: the turn has no solution, the way has one.
    start = [0.5, 0.0, 2 * math.pi - math.pi / 2]
    while (motion := plan([0.0, 0.0, 1.0], start)).reachable.all():
        start = motion.target[0].tolist()
    motion = plan([0.5, 0.0, 1.0], start)
    assert not motion.reachable.any()
    assert motion.target[0].tolist() == pytest.approx([start[0] + 0.01, start[1], start[2]])
    np.testing.assert_allclose(motion.position[0, -1], joints_at(motion.target[0]), atol=1e-9)


@pytest.mark.parametrize("distance", [0.10, 0.15, 0.25, 0.5, 0.75])
def test_the_panda_begins_with_its_elbow_aside_at_every_distance(distance) -> None:
    panda, rng = ROBOTS["panda"], np.random.default_rng(0)
    for azimuth, yaw in rng.uniform((-0.8, -3.1), (0.8, 3.1), (8, 2)):
        place = distance * np.array([math.cos(azimuth), math.sin(azimuth)]) + panda.base[:2]
        joints = start_joints(panda, TOOLS["2f85"], (*place, yaw), 0.02)
        low, high = panda.chain.limits.T
        assert ((low <= joints) & (joints <= high)).all()
        assert joints[2] > 0.05 or distance < 0.2  # on one side, so that no branch is passed
