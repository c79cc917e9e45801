from .arm_mask import ArmMask as ArmMask
from .controller import PushController as PushController
from .guard import Guard as Guard, Limits as Limits
from .height_map import HeightMap as HeightMap
from .perception import Perceived as Perceived, Perception as Perception
from .policy_file import load_policy as load_policy
from .pushing import Pushed as Pushed, push as push
from .robot_interface import (
    STOP_REASONS as STOP_REASONS,
    Command as Command,
    DepthImage as DepthImage,
    RobotInterface as RobotInterface,
    RobotState as RobotState,
    Stopped as Stopped,
)
from .simulated_robot import SimulatedRobot as SimulatedRobot
from .tracker import ObjectEstimate as ObjectEstimate, ObjectTracker as ObjectTracker
from .ur_robot import URRobot as URRobot
