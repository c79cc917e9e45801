"""The arm's mask against rendered images with the arm and without it."""

import mujoco
import numpy as np
import pytest

from modpush.deploy import ArmMask
from tests.deploy.scenes import CAMERA, ROBOT, TOOL, Bench


@pytest.mark.parametrize("tool_pose", [(0.25, -0.30, 0.0), (0.55, 0.1, 1.0), (0.68, -0.2, -0.6)])
def test_the_mask_covers_the_arm_and_little_else(tool_pose) -> None:
    bench = Bench()
    joints = bench.load("small_cube", (0.40, 0.25, 0.0), tool_pose)
    seen = bench.image(noise=False)
    model, data = bench.engine.simulation
    for body in range(model.nbody):  # everything but table and object out of sight
        if model.body(body).name not in ("world", "object"):
            model.geom_pos[model.geom_bodyid == body] = (0.0, 0.0, 50.0)
    mujoco.mj_forward(model, data)
    without = bench.image(noise=False)
    arm = np.abs(seen - without) > 1e-3
    mask = ArmMask(CAMERA, ROBOT, TOOL)(joints)
    assert arm.mean() > 0.02
    assert (arm & ~mask).sum() <= 1e-4 * arm.sum()
    assert mask.sum() < 1.35 * arm.sum() + 500
    assert not ArmMask(CAMERA, ROBOT, TOOL, margin=0.0)(joints)[:, :5].all()
