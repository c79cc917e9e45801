"""`Perception`: from a depth image and joint angles to what a policy reads."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from modpush._arguments import checked_arguments
from modpush.deploy.estimate import Perceived
from modpush.envs.robot.named import find_robot, find_tool
from modpush.envs.robot.robot import Robot, Tool
from modpush.envs.scenes.objects import PushedObject, get_object
from modpush.geometry.camera import CAMERA, Camera
from modpush.geometry.camera_model import CameraModel

__all__ = ["Perception"]


class Perception:
    """Sees the table, the obstacles and the pushed object through a fixed depth camera.

    Args:
        camera: The depth camera.
        pushed_object: The object, or its name.
        robot: The arm, or its name.
        tool: Its tool, or its name.
        view: The policy's camera, whose image is computed.
    """

    @checked_arguments
    def __init__(
        self,
        camera: CameraModel,
        pushed_object: str | PushedObject,
        robot: str | Robot = "ur5",
        tool: str | Tool = "2f85",
        view: Camera = CAMERA,
    ) -> None:
        self.camera, self.view = camera, view
        self.item = get_object(pushed_object)
        self.robot, self.tool = find_robot(robot), find_tool(tool)

    def reset(self, guess: Sequence[float] | None = None) -> None:
        """Forget the scene; the next image begins an episode.

        Args:
            guess: Pose (x, y, yaw) near which the object is [m, m, rad]; None looks for it everywhere.
        """
        raise NotImplementedError

    def update(self, depth: NDArray[np.float32], joints: NDArray[np.float64]) -> Perceived:
        """Take in an image.

        Args:
            depth: `[H, W]` of the camera, along its optical axis [m]; 0 or NaN without a reading.
            joints: Angles of the arm's joints when it was taken, `[n]` [rad].

        Raises:
            ValueError: If image or joints have another shape.
        """
        raise NotImplementedError
