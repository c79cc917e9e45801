"""Checks of the arguments that users give to the environments."""

import inspect
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

import numpy as np
import torch
from tensordict import TensorDictBase
from torch import Tensor

from modpush._checks import check_dtype
from modpush.envs.outcome import is_out_of_bounds, pose_errors
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


def parameter_names(function: Callable[..., Any]) -> list[str]:
    """Names of the parameters that a method declares, sorted, without `self`, `*args`, `**kwargs`."""
    return sorted(
        name
        for name, parameter in inspect.signature(function).parameters.items()
        if name != "self"
        and parameter.kind not in (parameter.VAR_KEYWORD, parameter.VAR_POSITIONAL)
    )


def refuse_unknown(caller: str, unknown: Iterable[str], expected: str) -> None:
    """Refuse unknown keyword arguments.

    Args:
        caller: Name of the called function.
        unknown: Names of the arguments.
        expected: Description of the known arguments, for the error.

    Raises:
        TypeError: If there are any.
    """
    # TorchRL's GymEnv looks for Python's own words to find out what an environment does not take.
    if names := ", ".join(repr(name) for name in sorted(unknown)):
        raise TypeError(
            f"{caller}: got an unexpected keyword argument {names}; expected {expected}."
        )


def check_device(device: torch.device) -> None:
    """Check the device of `PushEnv`.

    Raises:
        ValueError: If it is neither a CPU nor a CUDA device.
        RuntimeError: If it is not there.
    """
    if device.type not in ("cpu", "cuda"):
        raise ValueError(f"PushEnv: device must be 'cpu' or a CUDA device, got {str(device)!r}.")
    if device.type == "cuda" and not torch.cuda.is_available():
        raise RuntimeError(
            f"PushEnv: device={str(device)!r} needs CUDA, which torch does not find."
        )


def check_simulation(num_envs: int, sim_backend: str, sim_freq: int, control_freq: int) -> None:
    """Check the options of `ClutterPushEnv` that ManiSkill does not check, or not in plain words.

    Raises:
        ValueError: If CUDA is needed and there is none, or the frequencies do not fit.
    """
    on_cpu = not torch.cuda.is_available() or "cpu" in sim_backend
    if on_cpu and (num_envs > 1 or "cuda" in sim_backend):
        raise ValueError(
            f"ClutterPushEnv: num_envs={num_envs} in one task needs CUDA, since on a CPU a task "
            f"holds one scene. Use modpush.envs.PushEnv({num_envs}), or "
            f"gymnasium.make_vec('modpush/Push-v0', num_envs={num_envs})."
        )
    if sim_freq % control_freq:
        raise ValueError(
            "ClutterPushEnv: sim_freq must be a multiple of control_freq, "
            f"got {sim_freq} and {control_freq}."
        )


def scenes_to_reset(tensordict: TensorDictBase | None, num_envs: int) -> list[int]:
    """Indices of the scenes where the key `"_reset"` is True, or of all without that key.

    Raises:
        TypeError: If it is not bool.
    """
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
    """Check the episodes' starts that a reset is given.

    Args:
        scenarios: Must hold a `Scenario` for each scene being reset, which is not solved already.
        count: Number of scenes being reset.
        bounds: Lower and upper corner of where the object may be [m].
        tool: The tool.
        robot: The arm.
        simulation: Goal of the episodes.
        yaw_tolerance: Present yaw tolerance of goal poses [rad].
        objects: The objects by name; a scenario with another one is refused elsewhere.

    Raises:
        ValueError: If there are more or fewer, or an object starts at its goal or out of bounds: TorchRL
            refuses an episode that has ended before its first step. Also if the arm is in an obstacle.
        TypeError: If something else is among them.
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
    """Refuse a workspace in which the arm could not follow the object to every start.

    Raises:
        ValueError: If a place where episodes start is beyond the arm's reach or too near to it, or the
            arm does not point down over the table at home.
    """
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
        if radius < np.linalg.norm(places, axis=-1).min():
            raise ValueError(
                f"PushEnv: robot {robot.name!r}, whose base is at {base}, reaches to {most} m; the "
                f"workspace from {config.low} to {config.high} is up to {distance.max():.2f} m away. "
                "Expected a Robot.base nearer to the workspace, or a robot with more reach."
            )
        raise ValueError(
            f"PushEnv: robot {robot.name!r}, whose base is at {base}, reaches from {least} to {most} m; "
            f"this does not hold the workspace from {config.low} to {config.high}, with starts up to "
            f"{distance.max():.2f} m from the base. Expected max_start_radius (and max_goal_radius) of "
            f"at most {math.floor(100 * radius) / 100:.2f}, a smaller workspace (low and high), or a "
            "robot with more reach."
        )


def _check_home(robot: Robot) -> None:
    """Refuse an arm whose flange does not point down over the table at home, roughly."""
    flange = robot.link_transforms(np.array(robot.home))[-1]
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


def check_alone(**others: Any) -> None:
    """Refuse arguments of `PushEnv.reset` that cannot be given with `state`.

    Raises:
        ValueError: If one of them is not None.
    """
    if given := sorted(name for name, value in others.items() if value is not None):
        raise ValueError(f"PushEnv.reset: with state, {' and '.join(given)} must be None.")


def chosen_scenes(indices: Sequence[int] | None, num_envs: int) -> list[int]:
    """Indices of scenes that a user names, or of all if they are None.

    Raises:
        ValueError: If one is out of range or given twice.
    """
    chosen = list(range(num_envs)) if indices is None else [*_whole(indices)]
    if len(set(chosen)) < len(chosen) or not all(0 <= i < num_envs for i in chosen):
        raise ValueError(f"indices must be different and in [0, {num_envs - 1}], got {chosen}.")
    return chosen


def _whole(indices: Sequence[int], name: str = "indices") -> Sequence[int]:
    whole = isinstance(indices, Sequence | np.ndarray) and all(
        isinstance(i, int | np.integer) and not isinstance(i, bool) for i in indices
    )
    if not whole:
        raise TypeError(f"{name} must be whole numbers, got {indices!r}.")
    return [int(i) for i in indices]


def check_scene(index: int, num_envs: int) -> None:
    """Check the index of one scene.

    Raises:
        TypeError: If it is not a whole number.
        ValueError: If there is no such scene.
    """
    _whole([index], "index")
    if not 0 <= index < num_envs:
        raise ValueError(f"index must be in [0, {num_envs - 1}], got {index}.")


def check_action(action: Tensor, num_envs: int) -> None:
    """Check an action before it reaches compiled code, which checks nothing.

    Args:
        action: Must be `[num_envs, 3]`, float32 or float64, finite and in [-1, 1].
        num_envs: Number of scenes.

    Raises:
        ValueError: If it is not; the message names the scene.
    """
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
