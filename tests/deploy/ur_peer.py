"""A scripted peer in the place of `ur_rtde`: an arm that goes where it is told, and writes it down.

Names and arguments are those of `ur_rtde` 1.6.5.
"""

import sys
import time
from importlib.machinery import ModuleSpec
from types import ModuleType

import numpy as np

from modpush.envs.robot.named import find_robot, find_tool


class Peer:
    """What both interfaces share."""

    def __init__(self, joints, robot="ur5", tool="2f85") -> None:
        self.robot, self.tool = find_robot(robot), find_tool(tool)
        self.joints = np.array(joints, dtype=float)
        tip = self.robot.tip_transform(self.joints, self.tool)
        self.pose = [*(tip[:3, 3] - self.robot.base), 0.0, 0.0, 0.0]
        self.sent: list[tuple[float, list[float]]] = []
        self.log: list[str] = []
        self.connected = self.reachable = True
        self.protective = self.emergency = False
        self.refuse_after: int | None = None

    def take(self, pose: list[float]) -> bool:
        if self.refuse_after is not None and len(self.sent) >= self.refuse_after:
            return False
        self.sent.append((time.monotonic(), pose))
        self.pose = list(pose)
        yaw = 2 * np.arctan2(pose[4], pose[3])
        flange = np.array([[*pose[:2], pose[2] + self.tool.length, yaw]])
        self.joints = self.robot.inverse(flange, self.joints[None])[0][0]
        return True


def install(monkeypatch, peer: Peer) -> None:
    """Put modules named as those of `ur_rtde` into the place of theirs."""

    class RTDEControlInterface:
        def __init__(self, hostname: str, frequency: float = -1.0) -> None:
            if not peer.reachable:
                raise RuntimeError("Connection refused")
            peer.log.append(f"control {hostname} {frequency:g}")

        def servoL(self, pose, speed, acceleration, time, lookahead_time, gain):
            assert len(pose) == 6
            assert 0.03 <= lookahead_time <= 0.2
            assert 100 <= gain <= 2000
            return peer.take(pose)

        def servoStop(self, a: float = 10.0) -> bool:
            peer.log.append("servoStop")
            return True

        def stopScript(self) -> None:
            peer.log.append("stopScript")

        def isConnected(self) -> bool:
            return peer.connected

        def disconnect(self) -> None:
            peer.log.append("control disconnected")

    class RTDEReceiveInterface:
        def __init__(self, hostname: str, frequency: float = -1.0) -> None:
            if not peer.reachable:
                raise RuntimeError("Connection refused")

        def getActualQ(self) -> list[float]:
            return peer.joints.tolist()

        def getActualTCPPose(self) -> list[float]:
            return list(peer.pose)

        def isConnected(self) -> bool:
            return peer.connected

        def isProtectiveStopped(self) -> bool:
            return peer.protective

        def isEmergencyStopped(self) -> bool:
            return peer.emergency

        def disconnect(self) -> None:
            peer.log.append("receive disconnected")

    for name, cls in (
        ("rtde_control", RTDEControlInterface),
        ("rtde_receive", RTDEReceiveInterface),
    ):
        module = ModuleType(name)
        module.__spec__ = ModuleSpec(name, None)
        setattr(module, cls.__name__, cls)
        monkeypatch.setitem(sys.modules, name, module)
