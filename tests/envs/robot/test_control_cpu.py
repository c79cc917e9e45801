import numpy as np
import pytest
import torch

from modpush.envs.robot.control import MotionConfig, plan_motion, ramp
from modpush.envs.robot.control_cpu import plan_motion_cpu, planar_joints_cpu
from modpush.envs.robot.kinematics import planar_inverse_kinematics

CONFIG = MotionConfig()


@pytest.mark.parametrize("num_substeps", [8, 16])
def test_the_compiled_way_gives_the_same_numbers(num_substeps: int) -> None:
    generator = torch.Generator().manual_seed(0)

    def uniform(low: float, high: float, *shape: int) -> torch.Tensor:
        return torch.rand(*shape, generator=generator, dtype=torch.float64) * (high - low) + low

    n = 500
    action = uniform(-1.3, 1.3, n, 3)
    target = torch.cat(
        [uniform(0.05, 0.95, n, 1), uniform(-0.5, 0.5, n, 1), uniform(-7, 5, n, 1)], 1
    )
    tip = target + uniform(-0.02, 0.02, n, 3) * torch.tensor([1, 1, 10.0])
    height = uniform(0.17, 0.19, n)
    motion = plan_motion(action, target, tip, height, CONFIG)
    position, velocity = ramp(motion.joints, num_substeps, 15.0)
    arrays = (tensor.numpy() for tensor in (action, target, tip, height))
    got = plan_motion_cpu(*arrays, CONFIG, num_substeps, 15.0)
    assert not motion.reachable.all()
    for ours, theirs in zip(
        got, (motion.target, position, velocity, motion.reachable), strict=True
    ):
        torch.testing.assert_close(torch.from_numpy(ours), theirs, atol=1e-9, rtol=1e-9)


def test_one_compiled_pose_equals_the_kinematics() -> None:
    rng = np.random.default_rng(0)
    for pose in rng.uniform((-0.9, -0.9, -3.0), (0.9, 0.9, 3.0), (200, 3)):
        joints, reachable = planar_joints_cpu(pose, 0.183)
        expected, within = planar_inverse_kinematics(torch.from_numpy(pose), 0.183)
        assert reachable == bool(within)
        np.testing.assert_allclose(joints, expected, atol=1e-9)
