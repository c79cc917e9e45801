"""`Perception`: from a depth image and joint angles to what a policy reads."""

from collections.abc import Sequence
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from modpush._validation import checked_arguments
from modpush.deploy.arm_mask import ArmMask
from modpush.deploy.height_map import HeightMap, sort_pixels
from modpush.deploy.push_motion import tool_outlines
from modpush.deploy.tracker import ObjectEstimate, ObjectTracker
from modpush.envs.depth.raycast import Solids, draw
from modpush.envs.robot.named import find_robot, find_tool
from modpush.envs.robot.robot import Robot, Tool
from modpush.envs.scenes.objects import PushedObject, get_object
from modpush.geometry.camera import CAMERA, Camera, Label
from modpush.geometry.camera_model import CameraModel

_OBSTACLE = 0.010
"""Height from which the map's cells are an obstacle [m]."""
_AROUND, _AROUND_UNSURE = 0.015, 0.10
"""Distance from the object within which the map learns nothing, while its pose is confirmed and while it
is not [m]."""


class Perceived(NamedTuple):
    """Input of a policy's stack, from one depth image."""

    depth: NDArray[np.float32]
    """Image of the policy's camera, straight down, without the arm, `[H, W]` [m]."""
    segmentation: NDArray[np.uint8]
    """`[H, W]`, values of `modpush.geometry.Label`: table, object and obstacle."""
    object: ObjectEstimate
    """The pushed object."""
    tip_pose: tuple[float, float, float]
    """x, y, yaw of the tool's tip by the joint angles [m, m, rad]."""
    seen: NDArray[np.bool_]
    """`[H, W]`, the pixels' places on the table that this image or an earlier one has shown."""


class Sees(Protocol):
    """The part of perception that a controller needs; `Perception` has it."""

    item: PushedObject
    robot: Robot
    tool: Tool

    def reset(self, guess: Sequence[float] | None = None) -> None:
        """Forget the scene."""

    def update(self, depth: NDArray[np.float32], joints: NDArray[np.float64]) -> Perceived | None:
        """Take in an image; None if the object has not been found yet."""

    def hidden_by_arm(self, object_pose: NDArray[np.float64], joints: NDArray[np.float64]) -> float:
        """Share of the top of the object at a pose that the arm would hide."""

    def obstacle_cells(self) -> NDArray[np.float64]:
        """Places at which something stands, `[n, 2]` [m]."""


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
        self.heights = HeightMap(camera, view)
        self.tracker = ObjectTracker(self.item, camera, self.heights)
        self._arm = ArmMask(camera, self.robot, self.tool)
        self._solids = Solids.of(self.item.parts)
        width, height = camera.size
        self._kind = np.empty((height, width), np.uint8)
        self.reset()

    def reset(self, guess: Sequence[float] | None = None) -> None:
        """Forget the scene; the next image begins an episode.

        Args:
            guess: Place (x, y) or pose (x, y, yaw) near which the object is [m, m, rad]; None looks
                everywhere.
        """
        self.heights.reset()
        self.tracker.reset(guess)
        self._outlines: list[NDArray[np.float64]] | None = None

    def update(self, depth: NDArray[np.float32], joints: NDArray[np.floating]) -> Perceived | None:
        """Take in an image.

        Args:
            depth: `[H, W]` of the camera, along its optical axis [m]; 0 or NaN without a reading.
            joints: Angles of the arm's joints when it was taken, `[n]` [rad].

        Returns:
            What it shows; None if the object has not been found since the last reset.

        Raises:
            ValueError: If image or joints have another shape, or joints are not finite.
        """
        depth, joints = self._checked(depth, joints)
        flange = self.robot.link_transforms(joints)[-1]
        outlines = tool_outlines(self.tool, flange, self.item.height)
        sort_pixels(depth, self._arm(joints), self._kind)
        self.heights.look(depth, self._kind)
        before = self._outlines
        if before is None or len(before) != len(outlines):  # the tool was higher, or lower
            before = outlines
        estimate = self.tracker.update(depth, self._kind, before, outlines)
        self._outlines = outlines
        if estimate is None:
            return None
        x, y, _ = estimate.pose
        around = self.item.radius + (_AROUND if estimate.found else _AROUND_UNSURE)
        self.heights.keep(self.heights.cells_within(x, y, around))
        return self._perceived(estimate, flange)

    def hidden_by_arm(self, object_pose: NDArray[np.float64], joints: NDArray[np.float64]) -> float:
        """Share of the object's top that the arm would hide.

        Args:
            object_pose: x, y, yaw of the object [m, m, rad].
            joints: Angles of the arm's joints, `[n]` [rad].
        """
        column, row, _ = self.tracker.pixels_on_top(object_pose)
        return float(self._arm(joints)[row, column].mean()) if len(row) else 1.0

    def obstacle_cells(self) -> NDArray[np.float64]:
        """Places of the map's cells that are obstacles, `[n, 2]` [m]."""
        return self.heights.centers[self.heights.heights > _OBSTACLE]

    def _checked(
        self, depth: NDArray[np.float32], joints: NDArray[np.floating]
    ) -> tuple[NDArray[np.float32], NDArray[np.float64]]:
        width, height = self.camera.size
        if np.shape(depth) != (height, width):
            raise ValueError(
                f"Perception: depth must be [{height}, {width}], got {list(np.shape(depth))}."
            )
        angles, n = np.asarray(joints, dtype=np.float64), len(self.robot.joints)
        if angles.shape != (n,) or not np.isfinite(angles).all():
            raise ValueError(f"Perception: joints must be {n} finite angles [rad], got {joints!r}.")
        return np.ascontiguousarray(depth, dtype=np.float32), angles

    def _perceived(self, estimate: ObjectEstimate, flange: NDArray[np.float64]) -> Perceived:
        depth = self.heights.depth()
        obstacle = depth < self.view.z - _OBSTACLE
        segmentation = np.where(obstacle, np.uint8(Label.OBSTACLE), np.uint8(Label.TABLE))
        x, y, yaw = estimate.pose
        pose = np.array([[x, y, self.item.height / 2, np.cos(yaw / 2), 0.0, 0.0, np.sin(yaw / 2)]])
        draw(depth, segmentation, self._solids, pose, Label.OBJECT, self.view)
        tip = flange[:3, 3] + self.tool.length * flange[:3, 2]
        turn = float(np.arctan2(flange[1, 0], flange[0, 0]))
        return Perceived(
            depth=depth,
            segmentation=segmentation,
            object=estimate,
            tip_pose=(float(tip[0]), float(tip[1]), turn),
            seen=self.heights.seen | self.heights.shown,
        )
