from .arm_mask import ArmMask as ArmMask
from .controller import PushController as PushController
from .estimate import ObjectEstimate as ObjectEstimate, Perceived as Perceived
from .guard import Guard as Guard
from .height_map import HeightMap as HeightMap
from .limits import Limits as Limits
from .perception import Perception as Perception
from .policy_file import load_policy as load_policy
from .pushing import Pushed as Pushed, push as push
from .robot_interface import (
    Command as Command,
    DepthImage as DepthImage,
    RobotInterface as RobotInterface,
    RobotState as RobotState,
)
from .simulated_robot import SimulatedRobot as SimulatedRobot
from .stopped import STOP_REASONS as STOP_REASONS, Stopped as Stopped
from .tracker import ObjectTracker as ObjectTracker
from .ur_robot import URRobot as URRobot
