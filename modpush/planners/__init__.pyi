from .a_star import AStar as AStar
from .any_angle import (
    DistanceField as DistanceField,
    LazyThetaStar as LazyThetaStar,
    StraightLine as StraightLine,
)
from .grid_planner import Planner as Planner
from .named import PLANNERS as PLANNERS, make_planner as make_planner, warmup as warmup
from .occupancy import OccupancyGrid as OccupancyGrid
from .occupancy_map import OccupancyMap as OccupancyMap, inflate as inflate
from .paths import (
    Paths as Paths,
    check_paths as check_paths,
    fraction_subgoal as fraction_subgoal,
    lookahead_subgoal as lookahead_subgoal,
    point_along as point_along,
    points_ahead as points_ahead,
)
from .pose_field import PoseField as PoseField
from .pose_paths import (
    PosePaths as PosePaths,
    polygon_support as polygon_support,
    poses_along as poses_along,
)
from .pose_subgoals import PoseSubgoals as PoseSubgoals
from .subgoals import PlannerSubgoals as PlannerSubgoals
from .swept_obstacles import SweptObstacles as SweptObstacles
from .through_obstacles import ThroughObstacles as ThroughObstacles
