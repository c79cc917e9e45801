import math

import pytest
import pytorch_kinematics
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from modpush.envs.robot.kinematics import (
    NUM_BRANCHES,
    WORKING_BRANCH,
    forward_kinematics,
    inverse_kinematics,
    planar_forward_kinematics,
    planar_inverse_kinematics,
    tool_down_rotation,
)
from modpush.envs.robot.ur5_2f85 import JOINT_NAMES, TOOLS, urdf_path
from modpush.geometry import wrap_angle

HEIGHT = 0.02 + 0.163


def workspace_poses(n: int = 4000) -> torch.Tensor:
    """Planar poses all over the tool's workspace, `[<= n, 3]`."""
    generator = torch.Generator().manual_seed(0)
    u = torch.rand(n, 3, generator=generator, dtype=torch.float64)
    poses = u * torch.tensor([0.79, 0.94, 3.0]) + torch.tensor([0.08, -0.47, -1.5])
    radius = poses[:, :2].norm(dim=-1)
    return poses[(radius >= 0.16) & (radius <= 0.885)]


def tool_down_transform(poses: torch.Tensor) -> torch.Tensor:
    T = torch.eye(4, dtype=torch.float64).repeat(len(poses), 1, 1)
    T[:, :3, :3] = tool_down_rotation(poses[:, 2])
    T[:, :2, 3] = poses[:, :2]
    T[:, 2, 3] = HEIGHT
    return T


def test_zero_pose_is_the_published_one() -> None:
    # Stretched along -x: a2 + a3; sideways -(d4 + d6); height d1 - d5.
    expected = torch.tensor(
        [-0.425 - 0.39225, -(0.10915 + 0.0823), 0.089159 - 0.09465], dtype=torch.float64
    )
    T = forward_kinematics(torch.zeros(6, dtype=torch.float64))
    torch.testing.assert_close(T[:3, 3], expected, atol=1e-12, rtol=0)


@pytest.mark.parametrize("tool", sorted(TOOLS))
def test_forward_kinematics_equals_that_of_the_urdf(tool: str) -> None:
    chain = pytorch_kinematics.build_serial_chain_from_urdf(
        urdf_path(tool).read_bytes(), end_link_name="tool"
    ).to(dtype=torch.float64)
    assert tuple(chain.get_joint_parameter_names()) == JOINT_NAMES
    q = (torch.rand(200, 6, dtype=torch.float64) * 2 - 1) * math.pi
    expected = chain.forward_kinematics(q).get_matrix()
    torch.testing.assert_close(forward_kinematics(q), expected, atol=1e-7, rtol=0)


def test_inverse_undoes_forward_on_every_branch_over_the_workspace() -> None:
    T = tool_down_transform(workspace_poses())
    q, valid = inverse_kinematics(T)
    assert q.shape == (len(T), NUM_BRANCHES, 6)
    assert valid[:, WORKING_BRANCH].all()
    error = (forward_kinematics(q) - T[:, None]).abs().amax((-1, -2))
    assert error[valid].max() < 1e-9


@settings(max_examples=200, deadline=None)
@given(st.lists(st.floats(-math.pi, math.pi), min_size=6, max_size=6))
def test_some_branch_gives_any_joints_back(joints: list[float]) -> None:
    q = torch.tensor(joints, dtype=torch.float64)
    T = forward_kinematics(q)
    if abs(math.sin(joints[4])) < 1e-3:
        return  # the wrist is stretched: joints 4 and 6 turn about one axis and are not unique
    solutions, valid = inverse_kinematics(T)
    error = (forward_kinematics(solutions) - T).abs().amax((-1, -2))
    assert error[valid].max() < 1e-7
    assert wrap_angle(solutions - q).abs().amax(-1)[valid].min() < 1e-5


def test_planar_solution_is_the_working_branch() -> None:
    poses = workspace_poses()
    planar, reachable = planar_inverse_kinematics(poses, HEIGHT)
    general, _ = inverse_kinematics(tool_down_transform(poses))
    assert reachable.all()
    assert wrap_angle(planar - general[:, WORKING_BRANCH]).abs().max() < 1e-9
    back = planar_forward_kinematics(planar)
    assert (back[:, :2] - poses[:, :2]).abs().max() < 1e-9
    assert wrap_angle(back[:, 3] - poses[:, 2]).abs().max() < 1e-9


def test_working_branch_keeps_the_elbow_over_the_table() -> None:
    joints, _ = planar_inverse_kinematics(workspace_poses(), HEIGHT)
    # Height of the elbow: d1 + a2 sin(q2), a2 = -0.425.
    assert (0.089159 - 0.425 * torch.sin(joints[:, 1])).min() > 0.25


def test_no_branch_jumps_on_long_straight_pushes() -> None:
    generator = torch.Generator().manual_seed(1)
    ends = workspace_poses(400)
    starts = ends[torch.randperm(len(ends), generator=generator)]
    steps = torch.linspace(0, 1, 60, dtype=torch.float64)[:, None, None]
    line = starts + (ends - starts) * steps  # [60, n, 3], up to 2 cm a step
    radius = line[..., :2].norm(dim=-1)
    inside = ((radius >= 0.16) & (radius <= 0.885)).all(0)
    joints, reachable = planar_inverse_kinematics(line[:, inside], HEIGHT)
    assert inside.sum() > 100
    assert reachable.all()
    assert joints.diff(dim=0).abs().max() < 0.25


def test_yaw_may_wind_up_to_the_last_joints_limit_and_no_farther() -> None:
    pose = torch.tensor([[0.5, 0.0, 0.0]], dtype=torch.float64)
    joints, _ = planar_inverse_kinematics(pose, HEIGHT)
    room = 2 * math.pi + joints[0, 5]  # q6 falls as yaw grows, down to -2 pi
    for beyond, expected in ((-1e-6, True), (1e-6, False)):
        turned = pose.clone()
        turned[0, 2] += room + beyond
        assert bool(planar_inverse_kinematics(turned, HEIGHT)[1]) is expected


@pytest.mark.parametrize("radius", [0.0, 0.05, 1.0, 5.0])
def test_unreachable_poses_are_flagged_and_finite(radius: float) -> None:
    pose = torch.tensor([[radius, 0.0, 0.0]], dtype=torch.float64)
    joints, reachable = planar_inverse_kinematics(pose, HEIGHT)
    solutions, valid = inverse_kinematics(tool_down_transform(pose))
    assert not reachable.any()
    assert not valid[0, WORKING_BRANCH]
    assert joints.isfinite().all()
    assert solutions.isfinite().all()


@pytest.mark.parametrize(
    ("function", "shape", "message"),
    [
        (forward_kinematics, (2, 5), r"joint_position must be \[..., 6\], got \(2, 5\)"),
        (inverse_kinematics, (2, 3, 3), r"T_base_flange must be \[..., 4, 4\], got \(2, 3, 3\)"),
        (lambda x: planar_inverse_kinematics(x, 0.2), (2,), r"pose must be \[..., 3\]"),
    ],
)
def test_wrong_shapes_are_refused(function, shape, message) -> None:
    with pytest.raises(ValueError, match=message):
        function(torch.zeros(shape))
