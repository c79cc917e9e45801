from .estimate import ObjectEstimate as ObjectEstimate, Perceived as Perceived
from .perception import Perception as Perception
