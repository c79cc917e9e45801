import math

import pytest
import pytorch_kinematics
import torch

from modpush.envs.robot.kinematics import planar_inverse_kinematics
from modpush.envs.robot.ur5_2f85 import JOINT_NAMES, TOOLS, urdf_path
from modpush.geometry import wrap_angle
from tests.envs.robot.forward import forward_kinematics, planar_forward_kinematics

HEIGHT = 0.02 + 0.163


def workspace_poses(n: int = 4000) -> torch.Tensor:
    """Planar poses all over the tool's workspace, `[<= n, 3]`."""
    generator = torch.Generator().manual_seed(0)
    u = torch.rand(n, 3, generator=generator, dtype=torch.float64)
    poses = u * torch.tensor([0.79, 0.94, 3.0]) + torch.tensor([0.08, -0.47, -1.5])
    radius = poses[:, :2].norm(dim=-1)
    return poses[(radius >= 0.16) & (radius <= 0.885)]


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


def test_forward_undoes_inverse_over_the_workspace_with_the_tool_down() -> None:
    poses = workspace_poses()
    planar, reachable = planar_inverse_kinematics(poses, HEIGHT)
    assert reachable.all()
    back = planar_forward_kinematics(planar)
    assert (back[:, :2] - poses[:, :2]).abs().max() < 1e-9
    assert (back[:, 2] - HEIGHT).abs().max() < 1e-9
    assert wrap_angle(back[:, 3] - poses[:, 2]).abs().max() < 1e-9
    assert (forward_kinematics(planar)[:, 2, 2] + 1).abs().max() < 1e-9


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
    assert not reachable.any()
    assert joints.isfinite().all()


def test_wrong_shapes_are_refused() -> None:
    with pytest.raises(ValueError, match=r"pose must be \[..., 3\]"):
        planar_inverse_kinematics(torch.zeros(2), 0.2)
