from .depth.analytic import AnalyticDepthCamera as AnalyticDepthCamera
from .depth.base import (
    DepthCamera as DepthCamera,
    SceneView as SceneView,
)
from .engines.sapien.maniskill_task import ClutterPushEnv as ClutterPushEnv
from .engines.sapien.rendering import find_render_device as find_render_device
from .push_env import PushEnv as PushEnv
from .push_state import PushState as PushState
from .robot.named import ROBOTS as ROBOTS, TOOLS as TOOLS
from .robot.robot import (
    Joint as Joint,
    Link as Link,
    Robot as Robot,
    Tool as Tool,
)
from .scenes.arm_room import within_reach as within_reach
from .scenes.conditions import (
    SENSING as SENSING,
    EpisodeConditions as EpisodeConditions,
    SensingConfig as SensingConfig,
)
from .scenes.layouts import (
    ALL_SCENES as ALL_SCENES,
    HARD_SCENES as HARD_SCENES,
    HARD_WIDE_SCENES as HARD_WIDE_SCENES,
    OBSTACLE_SCENES as OBSTACLE_SCENES,
    SCENES as SCENES,
    TIGHT_SCENES as TIGHT_SCENES,
)
from .scenes.objects import OBJECTS as OBJECTS, PushedObject as PushedObject
from .scenes.obstacle import (
    Obstacle as Obstacle,
    Patrol as Patrol,
)
from .scenes.sampling import sample_scenario as sample_scenario
from .scenes.scenario import (
    Dynamics as Dynamics,
    Scenario as Scenario,
    ScenarioConfig as ScenarioConfig,
)
from .scenes.shape_layouts import SHAPE_SCENES as SHAPE_SCENES
