"""`sample_scenario`: draws an episode's start, and sees to it that it can be solved."""

import math
from collections import Counter
from collections.abc import Sequence
from typing import Any, NamedTuple, get_args

import cv2
import numpy as np

from modpush._checks import check_instance
from modpush._kernels import njit
from modpush.envs.outcome import Goal
from modpush.envs.robot.named import find_robot, find_tool
from modpush.envs.robot.robot import Robot, Tool
from modpush.envs.scenes.arm_room import obstacle_near_arm, tool_touches
from modpush.envs.scenes.layouts import TIGHT_SCENES, SceneFn
from modpush.envs.scenes.objects import PushedObject
from modpush.envs.scenes.obstacle import MAX_OBSTACLES, Obstacle
from modpush.envs.scenes.rectangles import (
    GRID_LOW,
    crosses_rectangle,
    nearest_rectangle,
    obstacle_distance,
    passable_cells,
    rectangles,
    turned_rectangles,
)
from modpush.envs.scenes.scenario import Dynamics, Scenario, ScenarioConfig

_CELLS = {"circumscribed": 0.01, "inscribed": 0.0025}
"""Sides of the cells of the grid that decides whether a path exists [m]. An object has a few millimetres
to spare in the passages that only its inscribed circle fits through."""
_BATCH = 256  # candidates drawn at a time
_BATCHES = 40
_LAYOUTS = 4
_OTHER_DISTANCES = 8  # layouts with a new distance each, where the first distance has no start
_REDRAWS = 100  # of a layout in which the arm has no room
_TOOL_TO_OBJECT, _TOOL_TO_OBSTACLE = 0.002, 0.005  # least gaps at the start [m]
_TOOL_GAP = 0.002  # least gap between its upper parts and obstacles [m]
_BEHIND = 0.09  # from the object's centre to the tool's tip, with `tool_start="behind"` [m]

_CONDITIONS = (
    "start beyond reach",
    "goal outside the workspace",
    "goal beyond reach",
    "start too close to an obstacle",
    "goal too close to an obstacle",
    "tool beyond reach",
    "tool touches the object",
    "tool touches an obstacle",
    "no path",
    "place of the tool taken",
    "no obstacle between start and goal",
)
"""Reasons against a candidate, in the order in which they are checked."""


class _Limits(NamedTuple):
    """The numbers that candidates are checked against [m]; the last three are least distances."""

    low_x: float
    low_y: float
    high_x: float
    high_y: float
    max_start_radius: float
    max_goal_radius: float
    min_tool_radius: float
    max_tool_radius: float
    base_x: float
    base_y: float
    object_to_obstacle: float  # of the object's centre, at start and goal
    tool_to_object: float  # of the tool's tip from the object's centre
    tool_to_obstacle: float  # of the tool's tip


class _Candidates(NamedTuple):
    """Starts of `n` episodes that may be good: places `[n, 2]` [m], angles and distances `[n]`."""

    start: np.ndarray
    yaw: np.ndarray
    goal: np.ndarray
    tool: np.ndarray
    tool_yaw: np.ndarray
    tool_distance: np.ndarray


class _FreeSpace(NamedTuple):
    """Places where the object fits, and connections along which it can be slid."""

    turned: np.ndarray
    """The obstacles, as `nearest_rectangle` reads them, `[n, 6]`."""
    labels: np.ndarray
    """Equal positive labels are joined, `[n, n]`; empty where nothing stands, or no path is required."""
    cell: float
    """Side of their cells [m]."""


def sample_scenario(
    rng: np.random.Generator,
    config: ScenarioConfig,
    *,
    tool: str | Tool = "2f85",
    robot: str | Robot = "ur5",
    goal: Goal = "position",
) -> Scenario:
    """Draw an episode's start.

    The distance from start to goal is drawn first and kept, so that it is uniform over its range
    whatever the layout; only where four layouts have no start at this distance is another one drawn.
    Start and goal keep their distance from obstacles, a path joins them on the
    grid inflated by the object's radius (`ScenarioConfig.path_inflation` says which), and the tool
    stands free and within reach. Layouts with an obstacle where the arm's links turn are
    drawn again. The number of tries is bounded.

    With `tool_start="behind"` a generator gives the layout, start and goal that it gives with `"any"`,
    as long as the place behind the object is free; where it is not, start and goal are drawn again.
    With `goal="pose"` it gives the start that it gives with `"position"`, and the goal's yaw on top.

    Args:
        rng: Source of randomness; the result depends on nothing else.
        config: Settings from which to draw.
        tool: The tool that the arm holds, see `SimulationConfig`.
        robot: The arm.
        goal: `"position"`, or `"pose"` for goals with a yaw, which is drawn uniformly.

    Raises:
        TypeError: If the generator or the config has another type.
        ValueError: If there is no such tool, robot or goal; if a scene leaves the arm no room in any of
            its layouts; or if no start is found, and then the message counts which condition failed how
            often.
    """
    check_instance("rng", rng, np.random.Generator)
    check_instance("config", config, ScenarioConfig)
    tool, robot = find_tool(tool), find_robot(robot)
    if goal not in get_args(Goal):
        raise ValueError(f"sample_scenario: goal must be one of {get_args(Goal)}, got {goal!r}.")
    scenes, objects = config.scenes, config.objects
    failed: Counter[str] = Counter()
    distance = float(rng.uniform(*config.distance))
    # In a tight scene that is drawn with too large a circle only short pushes would be left.
    tight = any(name in TIGHT_SCENES for name, _ in scenes)
    inscribed = config.path_inflation == "inscribed"
    layouts = _LAYOUTS if tight and not inscribed else _LAYOUTS + _OTHER_DISTANCES
    for layout in range(layouts):
        if layout >= _LAYOUTS:
            distance = float(rng.uniform(*config.distance))
        name, scene = scenes[rng.integers(len(scenes))]
        item = objects[rng.integers(len(objects))]
        difficulty = float(rng.uniform(*config.difficulty))
        obstacles = _draw_layout(rng, name, scene, difficulty, robot, tool)
        start = _draw_start(rng, config, distance, item, tool, robot, obstacles, failed)
        if start is not None:
            return Scenario(
                scene=name,
                difficulty=difficulty,
                obstacles=tuple(obstacles),
                pushed_object=item.name,
                **start,
                dynamics=_sample_dynamics(rng, config, item),
                goal_yaw=float(rng.uniform(-np.pi, np.pi)) if goal == "pose" else None,
            )
    reasons = ", ".join(f"{reason}: {n}" for reason, n in failed.most_common())
    advice = f" In {name!r} a path needs path_inflation='inscribed'."
    raise ValueError(
        f"sample_scenario: no start {config.distance} m from a goal found in scene {name!r} after "
        f"{layouts} layouts of {_BATCH * _BATCHES} tries each. Failed conditions: {reasons}."
        + (advice if name in TIGHT_SCENES and not inscribed else "")
    )


def _draw_start(
    rng: np.random.Generator,
    config: ScenarioConfig,
    distance: float,
    item: PushedObject,
    tool: Tool,
    robot: Robot,
    obstacles: list[Obstacle],
    failed: Counter[str],
) -> dict[str, Any] | None:
    """Object, goal and tool of an episode at a distance, as fields of `Scenario`; None if none is found.

    It counts in `failed` which condition failed how often.
    """
    free, limits = _free_space(obstacles, item, config), _limits(config, item, tool, robot)
    between = config.obstacle_between and len(obstacles) > 0
    for _ in range(_BATCHES):
        candidates = _draw_candidates(rng, config, distance)
        tool_poses, taken = _tool_starts(candidates, config, item, tool, robot, obstacles)
        i, counts = _first_good(candidates, taken, free, limits, between)
        while i >= 0 and tool_touches(tool_poses[i], item.tool_height, obstacles, tool, _TOOL_GAP):
            taken[i] = True
            i, counts = _first_good(candidates, taken, free, limits, between)
        if i >= 0:
            return {
                "object_pose": (*candidates.start[i].tolist(), float(candidates.yaw[i])),
                "goal_position": tuple(candidates.goal[i].tolist()),
                "tool_pose": tuple(tool_poses[i].tolist()),
            }
        failed.update(dict(zip(_CONDITIONS, counts.tolist(), strict=True)))
    return None


def _draw_layout(
    rng: np.random.Generator,
    name: str,
    scene: SceneFn,
    difficulty: float,
    robot: Robot,
    tool: Tool,
) -> list[Obstacle]:
    """The first layout in which the arm has room."""
    why: str | None = ""
    for _ in range(_REDRAWS):
        obstacles: Any = scene(rng, difficulty)
        good = isinstance(obstacles, Sequence) and all(isinstance(o, Obstacle) for o in obstacles)
        if not good or len(obstacles) > MAX_OBSTACLES:
            raise ValueError(
                f"scene: {name!r} must return a list of at most {MAX_OBSTACLES} Obstacle, got "
                f"{obstacles!r}."
            )
        why = obstacle_near_arm(obstacles, robot, tool)
        if why is None:
            return list(obstacles)
    raise ValueError(f"scene: {name!r} leaves the arm no room in {_REDRAWS} layouts: {why}.")


def _limits(config: ScenarioConfig, item: PushedObject, tool: Tool, robot: Robot) -> _Limits:
    """Clearances are taken from circumscribed circles: a little more than asked for, never less."""
    tool_radius = math.hypot(*tool.tip_half_extents)
    numbers = (
        *config.low,
        *config.high,
        config.max_start_radius,
        config.max_goal_radius,
        *robot.reach,
        *robot.base[:2],
        item.radius + config.clearance,
        item.radius + tool_radius + _TOOL_TO_OBJECT,
        tool_radius + _TOOL_TO_OBSTACLE,
    )
    return _Limits(*map(float, numbers))


def _draw_candidates(
    rng: np.random.Generator, config: ScenarioConfig, distance: float
) -> _Candidates:
    n = _BATCH
    start = rng.uniform(config.low, config.high, (n, 2))
    yaw = rng.uniform(-np.pi, np.pi, n)
    goal = start + _polar(np.full(n, distance), rng.uniform(-np.pi, np.pi, n))
    tool_distance = rng.uniform(*config.tool_distance, n)
    tool = start + _polar(tool_distance, rng.uniform(-np.pi, np.pi, n))
    tool_yaw = rng.uniform(-np.pi / 2, np.pi / 2, n)
    return _Candidates(start, yaw, goal, tool, tool_yaw, tool_distance)


def _polar(radius: np.ndarray, angle: np.ndarray) -> np.ndarray:
    return radius[:, None] * np.stack([np.cos(angle), np.sin(angle)], -1)


def _tool_starts(
    candidates: _Candidates,
    config: ScenarioConfig,
    item: PushedObject,
    tool: Tool,
    robot: Robot,
    obstacles: Sequence[Obstacle],
) -> tuple[np.ndarray, np.ndarray]:
    """Poses of the tool's tip `[n, 3]`, and which of them are taken, `[n]` bool.

    With `tool_start="any"` these are the candidates' own, which `_first_good` checks itself. Behind the
    object the circumscribed circles would overlap, so that the gap between the tool's wide side and the
    object's outline is measured.
    """
    if config.tool_start == "any":
        poses = np.column_stack([candidates.tool, candidates.tool_yaw])
        return poses, np.zeros(len(poses), bool)
    away = candidates.start - candidates.goal
    heading = np.arctan2(away[:, 1], away[:, 0])
    place = candidates.start + _polar(np.full(len(away), _BEHIND), heading)
    # The wide side is along the tool's x; half a turn makes no difference.
    yaw = heading % np.pi - np.pi / 2
    outline = np.concatenate(item.footprints())
    object_extent = (_polar(np.ones(len(away)), heading - candidates.yaw) @ outline.T).max(1)
    half_extents, reach = tool.tip_half_extents, np.linalg.norm(place - robot.base[:2], axis=1)
    taken = object_extent + half_extents[1] + _TOOL_TO_OBJECT > _BEHIND
    taken |= (reach < robot.reach[0]) | (reach > robot.reach[1])
    taken |= obstacle_distance(place, obstacles) < math.hypot(*half_extents) + _TOOL_TO_OBSTACLE
    return np.column_stack([place, yaw]), taken


@njit()
def _first_good(
    candidates: _Candidates,
    taken: np.ndarray,
    free: _FreeSpace,
    limits: _Limits,
    between: bool,
) -> tuple[int, np.ndarray]:
    """Index of the first candidate that meets every condition, or -1.

    With it how many failed which condition first, in the order of `_CONDITIONS`.
    """
    counts = np.zeros(11, np.int64)
    for i in range(len(candidates.start)):
        (sx, sy), (gx, gy) = candidates.start[i], candidates.goal[i]
        tx, ty = candidates.tool[i]
        out_x, out_y = tx - limits.base_x, ty - limits.base_y
        reach = math.sqrt(out_x * out_x + out_y * out_y)
        if math.sqrt(sx * sx + sy * sy) > limits.max_start_radius:
            counts[0] += 1
        elif not (limits.low_x <= gx <= limits.high_x and limits.low_y <= gy <= limits.high_y):
            counts[1] += 1
        elif math.sqrt(gx * gx + gy * gy) > limits.max_goal_radius:
            counts[2] += 1
        elif nearest_rectangle(sx, sy, free.turned) < limits.object_to_obstacle:
            counts[3] += 1
        elif nearest_rectangle(gx, gy, free.turned) < limits.object_to_obstacle:
            counts[4] += 1
        elif reach < limits.min_tool_radius or reach > limits.max_tool_radius:
            counts[5] += 1
        elif candidates.tool_distance[i] < limits.tool_to_object:
            counts[6] += 1
        elif nearest_rectangle(tx, ty, free.turned) < limits.tool_to_obstacle:
            counts[7] += 1
        elif not _joined(sx, sy, gx, gy, free):
            counts[8] += 1
        elif taken[i]:
            counts[9] += 1
        elif between and not crosses_rectangle(
            candidates.start[i], candidates.goal[i], free.turned
        ):
            counts[10] += 1
        else:
            return i, counts
    return -1, counts


@njit()
def _joined(sx: float, sy: float, gx: float, gy: float, free: _FreeSpace) -> bool:
    """True if a path joins two points; no labels mean that nothing has to be asked for."""
    first, last = 0, len(free.labels) - 1
    for x, y in ((sx, sy), (gx, gy)):
        if last < 0:
            return True
        i, j = int((x - GRID_LOW[0]) / free.cell), int((y - GRID_LOW[1]) / free.cell)
        label = free.labels[min(max(i, 0), last), min(max(j, 0), last)]
        if label == 0 or (first != 0 and first != label):
            return False
        first = label
    return True


def _free_space(
    obstacles: list[Obstacle], item: PushedObject, config: ScenarioConfig
) -> _FreeSpace:
    """Free places between which an object can be slid without ending the episode.

    On a grid over what the camera sees, and hardly out of the workspace.
    """
    circle = config.path_inflation or "circumscribed"
    labels, cell = np.zeros((0, 0), np.int32), _CELLS[circle]
    turned = turned_rectangles(rectangles(obstacles))
    if obstacles and config.path_required:
        low = np.subtract(config.low, config.path_margin)
        high = np.add(config.high, config.path_margin)
        passable = passable_cells(turned, item.radius_of(circle), low, high, cell)
        _, labels = cv2.connectedComponents(passable, connectivity=4)
    return _FreeSpace(turned, labels, cell)


def _sample_dynamics(
    rng: np.random.Generator, config: ScenarioConfig, item: PushedObject
) -> Dynamics:
    if not config.randomize_dynamics:
        return Dynamics(mass=item.mass)
    most = np.minimum(config.center_of_mass, np.array(item.sides) / 4)
    x, y = rng.uniform(-most, most)
    return Dynamics(
        mass=float(np.exp(rng.uniform(*np.log(config.mass)))),
        friction=float(rng.uniform(*config.friction)),
        center_of_mass=(float(x), float(y)),
    )
