"""`SimulationConfig`: robot, tool, goal, camera, rates, ends."""

import math
from typing import Any, Literal

from modpush._types import Count, Frequency, Length, YawTolerance
from modpush._validation import checked
from modpush.envs.engines.base import ENGINES, check_engine
from modpush.envs.outcome import GOAL_THRESHOLD, Goal
from modpush.envs.robot.named import check_robot, check_tool
from modpush.parts import check_part

_DEPTH_CAMERAS = ("analytic", "sapien")  # see `find_depth_camera`


@checked
class SimulationConfig:
    """Engine, robot, tool, goal, depth camera, rates and ends of episodes of a `PushEnv`."""

    engine: Any = "sapien"
    """Physics engine: `sapien`, `mujoco` (which needs the extra `mujoco`), or your own `Engine` as
    `module:name`, class or function."""
    robot: Any = "ur5"
    """Arm: `ur3`, `ur5`, `ur5e`, `ur10`, `panda`, or your own `Robot` as `module:name` or object. The
    `ur3` reaches half a metre and needs a smaller workspace."""
    tool: Any = "2f85"
    """Tool of the arm: the closed gripper `2f85`, the `rod` of the authors' code, or your own `Tool` as
    `module:name` or object."""
    goal: Goal = "position"
    """Kind of the goal: a position of the object's centre (the paper), or a pose of the object,
    at any yaw."""
    position_tolerance: Length = GOAL_THRESHOLD
    """Distance of the object's centre from the goal at which the episode succeeds [m]."""
    yaw_tolerance: YawTolerance = math.radians(10)
    """Largest difference of the object's yaw from that of a goal pose at success [rad]."""
    hold_steps: Count = 1
    """Number of control steps in a row at whose end the object must be at its goal."""
    full_circle: bool = False
    """Count yaw angles as different at which the object looks the same. By default a goal pose's yaw
    is met at any of them."""
    depth: Any = "analytic"
    """Depth camera: `analytic` (rays cast at the known shapes, needs no renderer), `sapien` (rendered),
    or your own `DepthCamera` as `module:name`, class or function. None in Python: no images."""
    arm_in_depth: bool = False
    """Show the arm in the image, as a real camera would. The paper sets the arm's pixels to
    background, which also hides what lies under it; the default leaves the arm out."""
    dynamic_obstacles: bool = False
    """Make obstacles movable."""
    obstacle_motion: bool = False
    """Emit the key `obstacle_motion`: place and velocity of the nearest obstacle that moves by itself."""
    object_dynamics: bool = False
    """Emit the key `object_dynamics`: mass, friction and centre of mass, which no image shows."""
    sim_freq: Frequency | None = None
    """Physics steps per second [Hz]; None for the engine's own, 120 in SAPIEN and 480 in MuJoCo. The
    paper gives no rate; the authors' code uses 240, in another simulator. In SAPIEN the scripted pusher
    solves 99 to 100 % of its episodes at 120 and at 240."""
    control_freq: Frequency = 15
    """Actions per second [Hz], of which `sim_freq` is a multiple."""
    max_episode_steps: Count | None = 200
    """Control steps after which an episode is truncated; None for no limit. The paper gives no
    number; the authors' code uses 200."""
    oob: Literal["truncate", "terminate"] = "truncate"
    """End of an episode whose object leaves the workspace, which the paper does not specify. Since
    every step has a cost, a policy that is still bad would do best to end its episode with the
    terminal penalty; with "truncate" the steps that would have followed count as well."""

    def __post_init__(self) -> None:
        check_engine("SimulationConfig", self.engine)
        check_robot("SimulationConfig", self.robot)
        check_tool("SimulationConfig", self.tool)
        rate = self.sim_freq
        # A list, since an engine given as an object may not be hashable.
        if rate is None and self.engine in [*ENGINES]:
            rate = ENGINES[self.engine].sim_freq
        if rate is not None and rate % self.control_freq:
            raise ValueError(
                "SimulationConfig: sim_freq must be a multiple of control_freq, "
                f"got {rate} and {self.control_freq}."
            )
        if self.depth is not None:
            cameras = "'module:name', a DepthCamera's class or function, or None"
            check_part("SimulationConfig: depth", self.depth, _DEPTH_CAMERAS, other=cameras)
