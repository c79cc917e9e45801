"""Depth cameras of one's own in `PushEnv`."""

import numpy as np
import pytest
import torch

from modpush.envs import PushEnv
from modpush.envs.depth.analytic import AnalyticDepthCamera
from modpush.envs.depth.base import DepthCamera
from modpush.geometry import CAMERA, Label


class NoisyCamera(AnalyticDepthCamera):
    """The analytic camera with a millimetre of noise on what stands on the table."""

    def capture(self, index, depth, segmentation):
        super().capture(index, depth, segmentation)
        noise = np.random.default_rng(0).normal(scale=1e-3, size=depth.shape)
        depth += np.where(segmentation == Label.TABLE, 0.0, noise).astype(np.float32)


class PointCamera(DepthCamera):
    """Marks a pixel for the object and one for each obstacle and link that it looks up."""

    def reset(self, index):
        assert self.scenes.scenarios[index].pushed_object == self.scenes.pushed_objects[0].name

    def capture(self, index, depth, segmentation):
        depth.fill(CAMERA.z)
        segmentation.fill(Label.TABLE)
        self.mark(segmentation, self.scenes.object_transform_of(index)[None], Label.OBJECT)
        self.mark(segmentation, self.scenes.obstacle_transforms_of(index), Label.OBSTACLE)
        if self.arm_in_depth:
            assert self.scenes.tool.name == "2f85"
            self.mark(segmentation, self.scenes.link_transforms_of(index, ["tool"]), Label.ROBOT)

    def mark(self, segmentation, transforms, label):
        for u, v in CAMERA.project(transforms[:, :2]).round().clip(0, 255).astype(int):
            segmentation[v, u] = label


def test_a_camera_may_be_given_by_class_by_text_or_by_function():
    plain = PushEnv(2, scene="slot", seed=0).reset()
    for depth in (NoisyCamera, f"{__name__}:NoisyCamera", lambda *args: NoisyCamera(*args)):
        td = PushEnv(2, scene="slot", seed=0, depth=depth).reset()
        assert torch.equal(td["segmentation"], plain["segmentation"])
        error = (td["depth"] - plain["depth"])[plain["segmentation"] != Label.TABLE]
        assert error.std().item() == pytest.approx(1e-3, rel=0.05)
        assert torch.equal(
            td["depth"][plain["segmentation"] == Label.TABLE],
            plain["depth"][plain["segmentation"] == Label.TABLE],
        )


class ReturningCamera(PointCamera):
    """Returns images, as Gymnasium's cameras do."""

    def capture(self, index, depth, segmentation):
        return np.full_like(depth, CAMERA.z), np.zeros_like(segmentation)


def test_a_camera_that_returns_its_images_is_refused():
    env = PushEnv(1, depth=ReturningCamera)
    with pytest.raises(TypeError, match=r"ReturningCamera.capture must write .*, got tuple"):
        env.reset()


@pytest.mark.parametrize("arm", [True, False])
def test_a_camera_finds_object_obstacles_and_arm_through_its_view(arm):
    env = PushEnv(1, scene="posts", seed=0, depth=PointCamera, arm_in_depth=arm)
    td = env.reset()
    for _ in range(2):
        labels = td["segmentation"][0, 0]
        assert (labels == Label.OBSTACLE).sum() == 4
        (row, column), *others = (labels == Label.OBJECT).nonzero().tolist()
        assert not others
        position = CAMERA.unproject(torch.tensor([column, row]))
        assert (position - td["object_pose"][0, :2]).norm() < CAMERA.cell_size
        assert (labels == Label.ROBOT).sum() == arm
        td = env.rand_step(td)["next"]
