from .a_star import AStar as AStar
from .base import (
    Paths as Paths,
)
from .base import (
    Planner as Planner,
)
from .base import (
    point_along as point_along,
)
from .distance_field import DistanceField as DistanceField
from .inflation import circumscribed_radius as circumscribed_radius
from .inflation import inflate as inflate
from .inflation import inscribed_radius as inscribed_radius
from .lazy_theta_star import LazyThetaStar as LazyThetaStar
from .occupancy import OccupancyGrid as OccupancyGrid
from .occupancy_map import OccupancyMap as OccupancyMap
from .straight_line import StraightLine as StraightLine
from .subgoals import (
    PlannerSubgoals as PlannerSubgoals,
)
from .subgoals import (
    fraction_subgoal as fraction_subgoal,
)
from .subgoals import (
    lookahead_subgoal as lookahead_subgoal,
)
from .theta_star import ThetaStar as ThetaStar
from .warm_up import warmup as warmup
