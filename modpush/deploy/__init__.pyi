from .arm_mask import ArmMask as ArmMask
from .estimate import ObjectEstimate as ObjectEstimate, Perceived as Perceived
from .height_map import HeightMap as HeightMap
from .perception import Perception as Perception
from .tracker import ObjectTracker as ObjectTracker
