"""Perception that knows the truth of a simulated scene, to test control apart from seeing."""

import numpy as np

from modpush.deploy.perception import Perceived
from modpush.deploy.simulated_robot import SimulatedRobot
from modpush.deploy.tracker import ObjectEstimate
from modpush.envs.depth.analytic import AnalyticDepthCamera
from modpush.geometry.camera import Label
from modpush.geometry.camera_model import CameraModel

CAMERA_ABOVE = CameraModel.looking_at((0.5, 0.0, 0.0), (0.2, 0.0, 1.2), up=(1.0, 0.0, 0.0))


class _View:
    """A `SceneView` of a simulated robot."""

    num_envs, dynamic_obstacles = 1, False

    def __init__(self, arm: SimulatedRobot) -> None:
        self._arm, self.scenarios = arm, [arm.scenario]
        self.pushed_objects, self.robot, self.tool = [arm.item], arm.robot, arm.tool

    def object_transform_of(self, index):
        return np.array(self._arm.scene.object_transform())

    def obstacle_transforms_of(self, index):
        return self._arm.scene.obstacle_transforms()

    def link_transforms_of(self, index, names):
        return np.array(self._arm.scene.link_transforms(names))


class TruePerception:
    """What `Perception` would say if it never erred."""

    def __init__(self, arm: SimulatedRobot, camera: CameraModel = CAMERA_ABOVE) -> None:
        self.arm, self.camera = arm, camera
        self.item, self.robot, self.tool = arm.item, arm.robot, arm.tool
        self.change = lambda perceived: perceived
        """Set by a test to spoil what is seen."""

    def reset(self, guess=None) -> None:
        self._images = AnalyticDepthCamera(_View(self.arm))
        self._images.reset(0)

    def update(self, depth, joints) -> Perceived:
        view = np.empty((256, 256), np.float32)
        labels = np.empty((256, 256), np.uint8)
        self._images.capture(0, view, labels)
        tip = self.robot.tip_transform(joints, self.tool)
        tip_pose = (*tip[:2, 3].tolist(), float(np.arctan2(tip[1, 0], tip[0, 0])))
        pose = tuple(self.arm.object_pose.tolist())
        estimate = ObjectEstimate(pose, residual=0.0, hidden=0.0, found=True, unseen_for=0)
        seen = labels != Label.OBJECT
        return self.change(Perceived(view, labels, estimate, tip_pose, seen))

    def hidden_by_arm(self, object_pose, joints) -> float:
        return 0.0

    def obstacle_cells(self):
        return np.zeros((0, 2))
