"""`URRobot`: one of Universal Robots' arms, through the package `ur_rtde`."""

import math
import threading
import time
from typing import Any

import numpy as np
from numpy.typing import NDArray

from modpush._extras import require_extra
from modpush._types import Length, Positive
from modpush._validation import checked_arguments
from modpush.deploy.robot_interface import Command, RobotInterface, RobotState
from modpush.envs.robot.named import find_robot, find_tool
from modpush.envs.robot.robot import Robot, Tool

_STOP_DECELERATION = 10.0  # of `servoStop` [m/s^2], the maker's default


class URRobot(RobotInterface):
    """A UR arm by RTDE. **It has never run on hardware**: only against a scripted peer in the tests.

    A thread sends the arm a pose on the straight way to the target with `servoL`, `frequency` times
    a second. When no command follows, the tip comes to the last target and stays there. The controller's
    tool centre point must be at the tool's tip, which `connect` compares with this library's kinematics.
    Needs the extra `ur`.

    Args:
        host: Address of the arm's controller.
        robot: The arm, or its name: `ur3`, `ur5`, `ur5e`, `ur10`.
        tool: Its tool, or its name.
        frequency: Poses per second [Hz]: 125 for the CB series, up to 500 for the e-series.
        lookahead: `servoL`'s time by which it smooths the motion, 0.03 to 0.2 [s].
        gain: `servoL`'s gain, 100 to 2000.
        tip_tolerance: Largest distance of the controller's tool centre point from the tip by this
            library's kinematics [m].

    Raises:
        MissingExtraError: If `ur_rtde` is not installed.
    """

    @checked_arguments
    def __init__(
        self,
        host: str,
        robot: str | Robot = "ur5",
        tool: str | Tool = "2f85",
        *,
        frequency: Positive = 125.0,
        lookahead: Positive = 0.1,
        gain: Positive = 300.0,
        tip_tolerance: Length = 0.005,
    ) -> None:
        require_extra("URRobot", "rtde_control", "rtde_receive")
        self.host, self.robot, self.tool = host, find_robot(robot), find_tool(tool)
        self._frequency, self._lookahead, self._gain = frequency, lookahead, gain
        self._tip_tolerance = tip_tolerance
        self._control: Any = None
        self._receive: Any = None
        self._lock = threading.Lock()
        self._servo: threading.Thread | None = None
        self._running = threading.Event()
        self._way: tuple[NDArray[np.float64], NDArray[np.float64], float, float] | None = None
        self._error: str | None = None
        self._due: float | None = None

    def connect(self) -> None:
        """See `RobotInterface`.

        Raises:
            ConnectionError: If there is no controller, it is not in remote control, or its tool centre
                point is not at the tip.
        """
        import rtde_control
        import rtde_receive

        try:
            self._receive = rtde_receive.RTDEReceiveInterface(self.host)
            self._control = rtde_control.RTDEControlInterface(self.host, self._frequency)
        except RuntimeError as error:
            self._receive = None
            raise ConnectionError(f"URRobot: no connection to {self.host}: {error}") from error
        self._error, self._way, self._due = None, None, None
        try:
            self._check_tip()
        except ConnectionError:
            self.close()
            raise

    def _check_tip(self) -> None:
        joints = self.observe().joints
        ours = self.robot.tip_transform(joints, self.tool)[:3, 3]
        theirs = np.array(self._receive.getActualTCPPose()[:3]) + self.robot.base
        if (distance := math.dist(ours, theirs)) > self._tip_tolerance:
            raise ConnectionError(
                f"URRobot: the controller's tool centre point {theirs.round(4).tolist()} must be at the "
                f"tip of {self.tool.name!r}, {ours.round(4).tolist()} by the kinematics of "
                f"{self.robot.name!r}, it is {distance * 1e3:.1f} mm away; set the TCP to "
                f"(0, 0, {self.tool.length}) and check which arm it is."
            )

    def observe(self) -> RobotState:
        """See `RobotInterface`; the stamp is `time.monotonic()`."""
        self._check_connected()
        joints = np.array(self._receive.getActualQ(), dtype=np.float64)
        return RobotState(joints, time.monotonic())

    def _check_connected(self) -> None:
        receive, control = self._receive, self._control
        if receive is None or control is None:
            raise ConnectionError("URRobot: not connected.")
        if self._error is not None:
            raise ConnectionError(f"URRobot: {self._error}")
        if not (receive.isConnected() and control.isConnected()):
            raise ConnectionError(f"URRobot: the connection to {self.host} is lost.")
        if receive.isEmergencyStopped():
            raise ConnectionError("URRobot: the emergency stop is pressed.")
        if receive.isProtectiveStopped():
            raise ConnectionError("URRobot: the arm has made a protective stop.")

    def command(self, command: Command) -> None:
        self._check_connected()
        now = time.monotonic()
        target = np.array([*command.target[:2], command.height, command.target[2]])
        with self._lock:
            begin = self._position(now)
            if begin is None:  # the first command: from where the tip is
                x, y, yaw = command.start
                begin = np.array([x, y, command.height, yaw])
            self._way = begin, target, now, command.duration
        if self._servo is None:
            self._running.set()
            self._servo = threading.Thread(target=self._serve, name="servoL", daemon=True)
            self._servo.start()
        # Steps begin at a fixed rate, whatever images and policy take, unless they take longer than one.
        due = now if self._due is None else max(self._due, now - command.duration)
        self._due = due + command.duration
        time.sleep(max(0.0, self._due - time.monotonic()))
        self._check_connected()

    def _position(self, now: float) -> NDArray[np.float64] | None:
        """x, y, z, yaw on the way at a time; None before the first command."""
        if self._way is None:
            return None
        begin, target, since, duration = self._way
        share = min((now - since) / duration, 1.0)
        return begin + share * (target - begin)

    def _serve(self) -> None:
        """Send poses until told to end; what goes wrong is told by the next call of the others."""
        period = 1 / self._frequency
        try:
            while self._running.is_set():
                begin = time.monotonic()
                with self._lock:
                    position = self._position(begin)
                if position is not None:
                    self._send(position, period)
                time.sleep(max(0.0, period - (time.monotonic() - begin)))
        except Exception as error:  # a thread has nobody to raise to
            self._error = f"servoL failed: {error}"

    def _send(self, position: NDArray[np.float64], period: float) -> None:
        pose = tool_down_pose(position[:3] - self.robot.base, position[3])
        # Speed and acceleration are of no effect in servoL.
        sent = self._control.servoL(pose, 0.0, 0.0, period, self._lookahead, self._gain)
        if sent is False:
            raise RuntimeError("the controller refused a pose; it may have stopped the program.")

    def stop(self) -> None:
        self._running.clear()
        if self._servo is not None and self._servo is not threading.current_thread():
            self._servo.join(timeout=1.0)
        self._servo, self._way, self._due = None, None, None
        if self._control is None:
            return
        try:
            self._control.servoStop(_STOP_DECELERATION)
        except RuntimeError as error:
            raise ConnectionError(f"URRobot: servoStop failed: {error}") from error

    def close(self) -> None:
        if self._control is None:
            return
        try:
            self.stop()
            self._control.stopScript()
        finally:
            self._control.disconnect()
            self._receive.disconnect()
            self._control = self._receive = None


def tool_down_pose(position: NDArray[np.float64], yaw: float) -> list[float]:
    """A pose as UR's controllers take it, of a tool that points straight down, in the arm's base frame.

    `yaw` is the angle of the tool's x axis from the base's, counter-clockwise seen from above [rad]. It
    returns x, y, z [m], and axis times angle of its turn [rad]: half a turn about the horizontal axis
    that halves the angle between the two x axes.
    """
    axis = math.pi * math.cos(yaw / 2), math.pi * math.sin(yaw / 2), 0.0
    return [*np.asarray(position, dtype=float).tolist(), *axis]
