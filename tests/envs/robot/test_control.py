import math

import pytest
import torch

from modpush.envs.robot.control import (
    MotionConfig,
    clamp_to_workspace,
    plan_motion,
    ramp,
)
from tests.envs.robot.forward import planar_forward_kinematics

CONFIG = MotionConfig()
HEIGHT = torch.tensor([0.183], dtype=torch.float64)


def plan(action, target, tip=None):
    target = torch.tensor([target], dtype=torch.float64)
    tip = target if tip is None else torch.tensor([tip], dtype=torch.float64)
    return plan_motion(torch.tensor([action]), target, tip, HEIGHT, CONFIG)


def test_full_action_moves_by_one_step() -> None:
    motion = plan([1.0, -1.0, 1.0], [0.5, 0.1, 0.2])
    expected = torch.tensor([[0.52, 0.08, 0.25]], dtype=torch.float64)
    torch.testing.assert_close(motion.target, expected)
    assert motion.reachable.all()


def test_actions_beyond_one_are_clipped() -> None:
    assert torch.equal(plan([9.0, 0, 0], [0.5, 0, 0]).target, plan([1.0, 0, 0], [0.5, 0, 0]).target)


def test_knots_lie_evenly_on_the_straight_way() -> None:
    motion = plan([1.0, 0.0, 0.0], [0.5, 0.0, 0.0])
    x = planar_forward_kinematics(motion.joints)[0, :, 0]
    expected = torch.linspace(0.5, 0.52, CONFIG.num_knots + 1, dtype=torch.float64)
    torch.testing.assert_close(x, expected, atol=1e-9, rtol=0)


def test_a_blocked_arm_does_not_wind_up() -> None:
    # Commanded 10 cm ahead of where the tip is: pulled back to 12 mm, then one step of 2 cm.
    motion = plan([1.0, 0.0, 0.0], [0.6, 0.0, 0.0], tip=[0.5, 0.0, 0.0])
    assert motion.target[0, 0].item() == pytest.approx(0.5 + 0.012 + 0.02)


def test_yaw_is_anchored_the_short_way_round() -> None:
    target = plan([0.0, 0.0, 0.0], [0.5, 0.0, math.pi + 0.05], tip=[0.5, 0.0, -math.pi]).target
    assert target[0, 2].item() == pytest.approx(math.pi + 0.05)


def test_targets_stay_in_the_workspace() -> None:
    far = torch.tensor([[5.0, 0.0], [0.0, 0.0], [0.87, 0.47]], dtype=torch.float64)
    inside = clamp_to_workspace(far, CONFIG)
    radius = inside.norm(dim=-1)
    assert (radius >= CONFIG.min_radius - 1e-9).all()
    assert (radius <= CONFIG.max_radius + 1e-9).all()
    assert inside[0].tolist() == pytest.approx([0.87, 0.0])


def test_an_unreachable_pose_leaves_the_target_where_it_was() -> None:
    # Wound up to just short of the last joint's limit, one more turn has no solution.
    joints_yaw = 2 * math.pi - math.pi / 2 + math.atan2(0, 0.5)
    start = [0.5, 0.0, joints_yaw]
    for _ in range(200):
        motion = plan([0.0, 0.0, 1.0], start)
        if not motion.reachable.all():
            break
        start = motion.target[0].tolist()
    assert not motion.reachable.any()
    assert motion.target[0].tolist() == pytest.approx(start)
    assert torch.equal(motion.joints[0, 0], motion.joints[0, -1])


@pytest.mark.parametrize("num_substeps", [8, 16, 6])
def test_ramp_passes_through_the_knots_at_constant_speed_between(num_substeps: int) -> None:
    joints = torch.randn(2, 5, 6, dtype=torch.float64)
    position, velocity = ramp(joints, num_substeps, 15.0)
    assert position.shape == velocity.shape == (2, num_substeps, 6)
    torch.testing.assert_close(position[:, -1], joints[:, -1])
    if num_substeps % 4 == 0:
        torch.testing.assert_close(position[:, num_substeps // 4 - 1], joints[:, 1])
        # Velocity is the position's own rate of change.
        moved = torch.cat([joints[:, :1], position], 1).diff(dim=1) * (15.0 * num_substeps)
        torch.testing.assert_close(velocity, moved)


@pytest.mark.parametrize(
    ("field", "value"),
    [("max_step", 0.0), ("num_knots", 0), ("max_radius", 0.1), ("low", (1.0, 0.0))],
)
def test_config_refuses_impossible_values(field, value) -> None:
    with pytest.raises(ValueError, match=field):
        MotionConfig(**{field: value})
