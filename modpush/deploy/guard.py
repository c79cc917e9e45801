"""`Guard`: stops an arm when something is not within `Limits`, and says what."""

import math
from collections.abc import Callable
from typing import NoReturn

import numpy as np
from numpy.typing import NDArray

from modpush._types import Fraction, Length, NonNegative, Point, Positive
from modpush._validation import checked
from modpush.deploy.controller import PushController
from modpush.deploy.robot_interface import (
    Command,
    DepthImage,
    RobotInterface,
    RobotState,
    Stopped,
    StopReason,
)
from modpush.envs.robot.control import MotionConfig
from modpush.geometry.camera_model import CameraModel

_GRID = 21  # points along each side of the workspace whose place in the image is checked
_ANCHOR = MotionConfig.anchor_distance + 0.003  # of a step's start from the measured tip [m]


_RATE = 15.0  # of the shipped agents [Hz]
_STEP = MotionConfig.max_step * math.sqrt(2)  # of a control step, in x and y together [m]


@checked
class Limits:
    """Bounds of motion and perception.

    The defaults are just above what the shipped agents do at 15 Hz.
    """

    low: Point = MotionConfig.low
    """Lower corner (x, y) of the tip's workspace [m]."""
    high: Point = MotionConfig.high
    """Upper corner (x, y) of the tip's workspace [m]."""
    height_tolerance: Length = 0.005
    """Largest difference of the tip's height from the commanded one [m]."""
    tilt: Positive = math.radians(2)
    """Largest angle between tool and vertical [rad]."""
    speed: Positive = 1.05 * _STEP * _RATE
    """Largest speed of the tip [m/s]."""
    turn_speed: Positive = 1.05 * MotionConfig.max_turn * _RATE
    """Largest angular speed of the tool [rad/s]."""
    joint_speed: Positive = math.pi
    """Largest speed of a joint that a command may ask for [rad/s]."""
    acceleration: Positive = 1.05 * 2 * _STEP * _RATE**2
    """Largest change of the commanded velocity in a control step, over its length [m/s^2]. A policy may
    turn back from one step to the next."""
    joint_margin: NonNegative = 0.02
    """Distance that joints keep from their limits [rad]."""
    image_age: Positive = 0.2
    """Largest age of a depth image [s]."""
    pose_jump: Length = 0.06
    """Largest distance of the object's poses in consecutive images, more than a tool pushes it [m]."""
    yaw_jump: Positive = math.radians(60)
    """Largest difference of their yaw angles, modulo the object's symmetry [rad]."""
    lost_for: Positive = 2.0
    """Time for which images may fail to confirm the object's pose, which is predicted meanwhile [s]. The
    arm may hide the object for a second and more."""
    in_view: Fraction = 0.99
    """Share of the workspace that must lie within the camera's image."""
    readings: Fraction = 0.3
    """Share of an image's pixels that must have a depth."""

    def __post_init__(self) -> None:
        if not (self.low[0] < self.high[0] and self.low[1] < self.high[1]):
            raise ValueError(f"Limits: low must be < high, got {self.low} and {self.high}.")


class Guard:
    """Stands between a controller and an arm, and checks every image and every command.

    Each check that fails stops the arm and raises `Stopped`. It does not replace the robot's own safety
    functions, an emergency stop, or a person who watches.

    Args:
        arm: The arm.
        controller: What commands it.
        camera: The camera of its images.
        limits: Bounds of motion and perception.
    """

    def __init__(
        self,
        arm: RobotInterface,
        controller: PushController,
        camera: CameraModel,
        limits: Limits | None = None,
    ) -> None:
        self.arm, self.controller, self.camera = arm, controller, camera
        self.limits = limits or Limits()
        self._robot, self._tool = controller.perception.robot, controller.perception.tool
        scenario = controller.agent.config.scenario
        self._workspace = scenario.low, scenario.high
        self._state: RobotState | None = None
        self._velocity = np.zeros(2)
        self._last_found: NDArray[np.float64] | None = None
        self._since_found = 0

    def stop(self, reason: StopReason, message: str) -> NoReturn:
        """Stop the arm and raise `Stopped`."""
        try:
            self.arm.stop()
        except ConnectionError as error:
            message = f"{message} The arm could not be told to stop: {error}"
        raise Stopped(reason, message)

    def begin(self) -> None:
        """Check camera, goal and arm before the first command; call it after the controller's `reset`.

        Raises:
            Stopped: If the camera does not see the workspace, the goal is out of reach, or the tool is
                not where an episode begins.
        """
        self._velocity, self._last_found, self._since_found = np.zeros(2), None, 0
        self._check_camera()
        self._check_goal()
        self._check_start(self.observe())

    def _check_camera(self) -> None:
        (low_x, low_y), (high_x, high_y) = self._workspace
        x, y = np.meshgrid(np.linspace(low_x, high_x, _GRID), np.linspace(low_y, high_y, _GRID))
        pixels, depth = self.camera.project(np.stack([x, y, np.zeros_like(x)], -1))
        size = np.array(self.camera.size)
        inside = (depth > 0) & ((pixels >= 0) & (pixels <= size - 1)).all(-1)
        if inside.mean() < self.limits.in_view:
            missing = ", ".join(
                f"({x[i]:.2f}, {y[i]:.2f})"
                for i in ((0, 0), (0, -1), (-1, 0), (-1, -1))
                if not inside[i]
            )
            self.stop(
                "camera",
                f"only {inside.mean():.0%} of the workspace {self._workspace} lies in the "
                f"camera's image; corners outside: {missing or 'none'}. Check camera_in_base and mount.",
            )

    def _check_goal(self) -> None:
        goal = self.controller.goal
        assert goal is not None
        (low_x, low_y), (high_x, high_y) = self._workspace
        x, y = goal[:2]
        if not (low_x <= x <= high_x and low_y <= y <= high_y):
            self.stop(
                "goal",
                f"({x:.3f}, {y:.3f}) lies outside the workspace {self._workspace} [m].",
            )
        bx, by, bz = self._robot.base
        height = self.controller.tip_height + self._tool.length
        pose = np.array([[x - bx, y - by, height - bz, 0.0]])
        _, found = self._robot.inverse(pose, np.array([self._robot.home]))
        radius = math.hypot(x - bx, y - by)
        if not found[0] or not self._robot.reach[0] <= radius <= self._robot.reach[1]:
            self.stop(
                "goal",
                f"({x:.3f}, {y:.3f}) is out of the reach of {self._robot.name!r}, {radius:.2f} m from "
                f"its axis; it reaches {self._robot.reach[0]} to {self._robot.reach[1]} m.",
            )

    def _check_start(self, state: RobotState) -> None:
        transform = self._robot.tip_transform(state.joints, self._tool)
        height, down = float(transform[2, 3]), float(-transform[2, 2])
        tilt = math.acos(min(max(down, -1.0), 1.0))
        if tilt > self.limits.tilt:
            self.stop("start", f"the tool must point straight down, it is {tilt:.3f} rad off.")
        if abs(height - self.controller.tip_height) > self.limits.height_tolerance:
            self.stop(
                "start",
                f"the tip must be {self.controller.tip_height:.3f} m over the table, it is at "
                f"{height:.3f} m; drive it there first, beside object and obstacles.",
            )

    def observe(self) -> RobotState:
        """The arm's state, checked.

        Raises:
            Stopped: If the connection is lost, or a joint is at its limit.
        """
        try:
            state = self._state = self.arm.observe()
        except ConnectionError as error:
            self.stop("connection", str(error))
        self._check_joints("the joint", state.joints)
        return state

    def _check_joints(self, subject: str, joints: NDArray[np.float64]) -> None:
        margin = self.limits.joint_margin
        for joint, angle in zip(self._robot.joints, joints.tolist(), strict=True):
            low, high = joint.limits
            if not low + margin <= angle <= high - margin:
                self.stop(
                    "joint_limit",
                    f"{subject} {joint.name!r} at {angle:.3f} rad, within {margin} rad of its limits "
                    f"({low:.3f}, {high:.3f}).",
                )

    def read_image(self, read_depth: Callable[[], DepthImage]) -> DepthImage:
        """The newest depth image, checked; call it after `observe`.

        Args:
            read_depth: Reads it. A camera that is gone raises a `ConnectionError`.

        Raises:
            Stopped: If the image is too old or nearly empty, or the camera is gone.
        """
        assert self._state is not None
        try:
            image = read_depth()
        except ConnectionError as error:
            self.stop("connection", str(error))
        age = self._state.stamp - image.stamp
        if not age <= self.limits.image_age:
            self.stop(
                "stale_image",
                f"the newest depth image is {age:.2f} s old, allowed are {self.limits.image_age} s.",
            )
        share = float((image.depth > 0).mean())  # False for NaN
        if share < self.limits.readings:
            self.stop(
                "camera",
                f"only {share:.0%} of the image's pixels have a depth, at least "
                f"{self.limits.readings:.0%} must; something covers the camera.",
            )
        return image

    def check_view(self) -> None:
        """Check what the controller has seen in the image of its last `act`.

        Raises:
            Stopped: If the object is lost, or its pose has jumped; at the start, if no way leads to the
                goal.
        """
        seen = self.controller.perceived
        assert seen is not None
        first = self._last_found is None
        if first and not self.controller.path_found:
            self.stop("goal", "no way leads the object to the goal between the obstacles.")
        lost = seen.object.unseen_for / self.controller.rate
        if lost > self.limits.lost_for:
            self.stop(
                "object_lost",
                f"no image has confirmed the pose of {self.controller.perception.item.name!r} for "
                f"{lost:.2f} s; it was last near ({seen.object.pose[0]:.3f}, {seen.object.pose[1]:.3f}).",
            )
        self._since_found += 1
        if seen.object.found:
            pose = np.array(seen.object.pose)
            if not first:
                self._check_jump(pose)
            self._last_found, self._since_found = pose, 0

    def _check_jump(self, pose: NDArray[np.float64]) -> None:
        assert self._last_found is not None
        x, y, turn = pose - self._last_found
        symmetry = self.controller.perception.item.symmetry
        period = 2 * math.pi / max(symmetry, 1)
        turn = 0.0 if symmetry == 0 else abs((turn + period / 2) % period - period / 2)
        distance, images = math.hypot(x, y), self._since_found
        if distance > self.limits.pose_jump * images or turn > self.limits.yaw_jump * images:
            self.stop(
                "pose_jump",
                f"the object's pose moved by {distance * 1e3:.0f} mm and {math.degrees(turn):.0f} "
                f"degrees in {images} images; something else has moved it, or took its place.",
            )

    def command(self, command: Command) -> None:
        """Check a command and hand it to the arm.

        Raises:
            Stopped: If it leaves the workspace, is too fast, asks for a joint at its limit, or the
                connection is lost.
        """
        limits, state = self.limits, self._state
        assert state is not None
        x, y = command.target[:2].tolist()
        inside = limits.low[0] <= x <= limits.high[0] and limits.low[1] <= y <= limits.high[1]
        if not inside or abs(command.height - self.controller.tip_height) > limits.height_tolerance:
            self.stop(
                "workspace",
                f"the tip would go to ({x:.3f}, {y:.3f}), {command.height:.3f} m over the table; its "
                f"workspace is {limits.low} to {limits.high} at {self.controller.tip_height:.3f} m.",
            )
        self._check_speed(command, state)
        self._check_joints("the command would bring the joint", command.joints)
        try:
            self.arm.command(command)
        except ConnectionError as error:
            self.stop("connection", str(error))

    def _check_speed(self, command: Command, state: RobotState) -> None:
        limits = self.limits
        tip = self._robot.tip_transform(state.joints, self._tool)[:2, 3]
        ahead = math.dist(tip, command.start[:2])
        velocity = (command.target - command.start)[:2] / command.duration
        speed, turn = math.hypot(*velocity), abs(command.target[2] - command.start[2])
        joints = np.abs(command.joints - state.joints).max() / command.duration
        if not (
            ahead <= _ANCHOR
            and speed <= limits.speed
            and turn / command.duration <= limits.turn_speed
            and joints <= limits.joint_speed
        ):
            self.stop(
                "speed",
                f"the command begins {ahead * 1e3:.0f} mm from the tip and asks for {speed:.2f} m/s, "
                f"{turn / command.duration:.2f} rad/s and {joints:.2f} rad/s of a joint; allowed are "
                f"{_ANCHOR * 1e3:.0f} mm, {limits.speed:.2f} m/s, {limits.turn_speed:.2f} rad/s and "
                f"{limits.joint_speed:.2f} rad/s.",
            )
        change = math.dist(velocity, self._velocity) / command.duration
        if not change <= limits.acceleration:
            self.stop(
                "acceleration",
                f"the command asks for {change:.1f} m/s^2, allowed are {limits.acceleration:.1f} m/s^2.",
            )
        self._velocity = velocity
