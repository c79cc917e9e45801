import numpy as np
import pytest

import modpush
from modpush.deploy import DepthImage, Guard, PushController, SimulatedRobot, push
from modpush.envs import Scenario
from tests.deploy.truth import CAMERA_ABOVE, TruePerception


@pytest.fixture(scope="session")
def agent():
    return modpush.load_agent("any_object")


def straight_push(**changes) -> Scenario:
    """A cube 15 cm before its goal, with the tool behind it and nothing in the way."""
    fields = {
        "scene": "free",
        "difficulty": 0.0,
        "obstacles": (),
        "pushed_object": "small_cube",
        "object_pose": (0.45, 0.0, 0.0),
        "goal_position": (0.60, 0.05),
        "tool_pose": (0.36, 0.0, 0.0),
    }
    return Scenario(**{**fields, **changes})


class Rig:
    """Arm, perception, controller and guard of one scene."""

    def __init__(self, agent, scenario=None, camera=CAMERA_ABOVE, limits=None, **options) -> None:
        self.scenario = scenario or straight_push()
        self.arm = SimulatedRobot(self.scenario)
        self.arm.connect()
        self.stops = 0
        stop = self.arm.stop

        def counted() -> None:
            self.stops += 1
            stop()

        self.arm.stop = counted
        self.seen = TruePerception(self.arm, camera)
        self.controller = PushController(agent, self.seen, **options)
        self.guard = Guard(self.arm, self.controller, camera, limits)
        self.delay = 0.0

    def read_depth(self) -> DepthImage:
        width, height = self.guard.camera.size
        return DepthImage(np.ones((height, width), np.float32), self.arm.time - self.delay)

    def push(self, goal=None, **options):
        return push(self.guard, self.read_depth, goal or self.scenario.goal_position, **options)


@pytest.fixture
def rig(agent) -> Rig:
    return Rig(agent)
