"""Checks of the arguments that users give to the environments."""

import math
from collections.abc import Mapping, Sequence

import numpy as np
import torch
from tensordict import TensorDictBase
from torch import Tensor

from modpush._checks import check_dtype
from modpush._types import Several
from modpush._validation import check_value
from modpush.envs.outcome import is_out_of_bounds, pose_errors
from modpush.envs.push_state import object_digest
from modpush.envs.robot.control import checked_solution
from modpush.envs.robot.robot import Robot, Tool
from modpush.envs.scenes.arm_room import check_arm_is_free
from modpush.envs.scenes.objects import PushedObject
from modpush.envs.scenes.scenario import Scenario, ScenarioConfig
from modpush.envs.simulation_config import SimulationConfig
from modpush.envs.specs import ACTION_SIZE
from modpush.geometry.workspace import Rectangle

_DOWN = 0.7  # least cosine of the angle of the flange from straight down at home
_REACH_ROUNDING = 1e-6  # [m]
_ROUNDING = 1e-4  # an action may exceed its bounds by this much


def check_device(device: torch.device) -> None:
    """Refuse a device that `PushEnv` cannot have: neither a CPU nor CUDA, or not there."""
    if device.type not in ("cpu", "cuda"):
        raise ValueError(f"PushEnv: device must be 'cpu' or a CUDA device, got {str(device)!r}.")
    if device.type == "cuda" and not torch.cuda.is_available():
        raise RuntimeError(
            f"PushEnv: device={str(device)!r} needs CUDA, which torch does not find."
        )


def scenes_to_reset(tensordict: TensorDictBase | None, num_envs: int) -> list[int]:
    """Indices of the scenes where the key `"_reset"` is True, or of all without that key."""
    if tensordict is None or "_reset" not in tensordict.keys():
        return list(range(num_envs))
    check_dtype("_reset", tensordict["_reset"], torch.bool)
    mask = tensordict["_reset"].reshape(num_envs, -1).any(-1)
    return torch.nonzero(mask).flatten().tolist()


def check_scenarios(
    scenarios: Sequence[Scenario],
    count: int,
    bounds: Rectangle,
    tool: Tool,
    robot: Robot,
    simulation: SimulationConfig,
    yaw_tolerance: float,
    objects: Mapping[str, PushedObject],
) -> None:
    """Check the episodes' starts that a reset is given, one for each of `count` scenes.

    TorchRL refuses an episode that has ended before its first step, so that an object must start within
    `bounds` [m] and not at its goal; `yaw_tolerance` [rad] is the present one. Nothing may stand in the
    arm. A scenario with another object than `objects` is refused elsewhere.
    """
    if not isinstance(scenarios, Sequence) or len(scenarios) != count:
        got = len(scenarios) if isinstance(scenarios, Sequence) else type(scenarios).__name__
        raise ValueError(
            f"scenarios must have one entry for each of the {count} scenes being reset, got {got}."
        )
    for index, scenario in enumerate(scenarios):
        if not isinstance(scenario, Scenario):
            raise TypeError(f"scenarios[{index}] must be a Scenario, got {scenario!r}.")
        _check_goal(f"scenarios[{index}]", scenario, simulation, yaw_tolerance, objects)
        position = np.array([scenario.object_pose[:2]])
        if is_out_of_bounds(position, bounds)[0]:
            raise ValueError(
                f"scenarios[{index}] must start within {bounds}, got {position[0].tolist()}: it "
                "would have ended before its first step."
            )
        if scenario.pushed_object in objects:
            tip_height = objects[scenario.pushed_object].tool_height
            check_arm_is_free(f"scenarios[{index}]", scenario, tip_height, tool, robot)


def check_reach(robot: Robot, config: ScenarioConfig) -> None:
    """Refuse a workspace whose starts are not all within the arm's reach."""
    _check_home(robot)
    (x0, y0), (x1, y1) = config.low, config.high
    grid = np.stack(np.meshgrid(np.linspace(x0, x1, 23), np.linspace(y0, y1, 29)), -1)
    places = grid[np.linalg.norm(grid, axis=-1) <= config.max_start_radius]
    distance = np.linalg.norm(places - robot.base[:2], axis=-1)
    least, most = robot.reach
    base = robot.base[:2]
    if distance.min(initial=most) < least - _REACH_ROUNDING:
        raise ValueError(
            f"PushEnv: robot {robot.name!r}, whose base is at {base}, reaches from {least} to {most} m; "
            f"the workspace from {config.low} to {config.high} begins {distance.min():.2f} m from the "
            "base. Expected a Robot.base farther from it, or a smaller workspace (low and high)."
        )
    if distance.max(initial=0.0) > most:
        radius = np.linalg.norm(places[distance > most], axis=-1).min() - 0.01
        advice = "a Robot.base nearer to the workspace, a smaller workspace (low and high)"
        if radius >= np.linalg.norm(places, axis=-1).min():
            advice = (
                "max_start_radius (and max_goal_radius) of at most "
                f"{math.floor(100 * radius) / 100:.2f}, a smaller workspace (low and high)"
            )
        raise ValueError(
            f"PushEnv: robot {robot.name!r}, whose base is at {base}, reaches from {least} to {most} m; "
            f"this does not hold the workspace from {config.low} to {config.high}, with starts up to "
            f"{distance.max():.2f} m from the base. Expected {advice}, or a robot with more reach; "
            "modpush evaluate, demo and play have an option for the robot alone."
        )


def check_new_scenario(
    config: ScenarioConfig,
    present: ScenarioConfig,
    simulation: SimulationConfig,
    digests: Mapping[str, str],
) -> None:
    """Refuse episodes that an environment was not built for; `digests` are those of its objects."""
    if config.bounds() != present.bounds():
        raise ValueError(
            "PushEnv: scenario must keep low and high, the running episodes' workspace, "
            f"{present.low} and {present.high}, got {config.low} and {config.high}."
        )
    check_tolerance(config, simulation)
    if config.pushed_object != present.pushed_object:
        found = {item.name: object_digest(item) for item in config.objects}
        if other := sorted(n for n, digest in found.items() if digests.get(n) != digest):
            raise ValueError(
                f"PushEnv: scenario must have objects of {sorted(digests)}, as they were when "
                f"the environment was made, got {other}."
            )


def check_tolerance(config: ScenarioConfig, simulation: SimulationConfig) -> None:
    """Refuse distances at which an episode would have ended before its first step."""
    if config.distance[0] < (tolerance := simulation.position_tolerance):
        raise ValueError(
            f"PushEnv: distance must be at least position_tolerance, {tolerance} m, at which an "
            f"episode succeeds, got {config.distance}."
        )


def _check_home(robot: Robot) -> None:
    """Refuse an arm whose flange does not point down over the table at home, roughly."""
    flange = robot.link_transforms(np.array(robot.home))[-1]
    # A solver of the user's that returns another form is refused here, before the first step.
    checked_solution(robot, np.array([[*(flange[:3, 3] - robot.base), 0.0]]))
    (x, y, z), down = flange[:3, 3].round(3).tolist(), -float(flange[2, 2])
    if down < _DOWN or z <= 0:
        raise ValueError(
            f"PushEnv: at home the flange of robot {robot.name!r} is at ({x:g}, {y:g}, {z:g}) m and its "
            f"z axis points along {tuple((flange[:3, 2].round(2) + 0.0).tolist())}; expected above the "
            "table, z > 0, and down, (0, 0, -1). See home, flange_rpy, base and the joints' rpy."
        )


def _check_goal(
    name: str,
    scenario: Scenario,
    simulation: SimulationConfig,
    yaw_tolerance: float,
    objects: Mapping[str, PushedObject],
) -> None:
    """Refuse a goal of another kind than the environment's, and a start at the goal."""
    poses = simulation.goal == "pose"
    if poses != (scenario.goal_yaw is not None):
        raise ValueError(
            f"{name} must have {'a' if poses else 'no'} goal_yaw with goal={simulation.goal!r}, got "
            f"{scenario.goal_yaw}."
        )
    pose, goal = scenario.object_pose, (*scenario.goal_position, scenario.goal_yaw or 0.0)
    item = objects.get(scenario.pushed_object)
    symmetry = 1 if simulation.full_circle or item is None else item.symmetry
    errors = pose_errors(np.array([pose]), np.array([goal]), np.array([symmetry]))
    distance, turn = np.abs(errors[0]).tolist()
    if distance > simulation.position_tolerance or (poses and turn > yaw_tolerance):
        return
    turned = f" or be turned by more than {yaw_tolerance:.3g} rad," if poses else ","
    raise ValueError(
        f"{name} must start more than {simulation.position_tolerance} m from its goal{turned} "
        f"got {distance:.3g} m: it would have ended before its first step."
    )


def chosen_scenes(indices: Sequence[int] | None, num_envs: int) -> list[int]:
    """Indices of scenes that a user names, or of all if they are None."""
    if indices is None:
        return list(range(num_envs))
    chosen: list[int] = list(check_value("indices", indices, Several[int]))
    if len(set(chosen)) < len(chosen) or not all(0 <= i < num_envs for i in chosen):
        raise ValueError(f"indices must be different and in [0, {num_envs - 1}], got {chosen}.")
    return chosen


def check_action(action: Tensor, num_envs: int) -> None:
    """Check an action before it reaches compiled code: `[num_envs, 3]`, finite and in [-1, 1]."""
    if action.shape != (num_envs, ACTION_SIZE) or action.dtype not in (
        torch.float32,
        torch.float64,
    ):
        raise ValueError(
            f"PushEnv.step: action must be float32 of shape ({num_envs}, {ACTION_SIZE}), "
            f"got {str(action.dtype).removeprefix('torch.')} of shape {tuple(action.shape)}."
        )
    good = (np.abs(action.cpu().numpy()) <= 1.0 + _ROUNDING).all(-1)  # False for NaN
    if not good.all():
        index = int(np.argmin(good))
        raise ValueError(
            f"PushEnv.step: action of scene {index} must be finite and in [-1, 1], "
            f"got {action[index].tolist()}."
        )
