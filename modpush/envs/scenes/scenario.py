"""Everything that an episode starts from, as plain data, and the sampler that draws it (spec 2)."""

import functools
import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

import cv2
import numba
import numpy as np

from modpush.envs.scenes.layouts import (
    MAX_OBSTACLES,
    Obstacle,
    SceneFn,
    get_scene,
    nearest_rectangle,
    obstacle_distance,
    rectangles,
    turned_rectangles,
)
from modpush.envs.scenes.objects import PushedObject, get_object

__all__ = ["BOUNDS_MARGIN", "Bounds", "Dynamics", "Scenario", "ScenarioConfig", "sample_scenario"]

Bounds = tuple[tuple[float, float], tuple[float, float]]
"""Lower and upper corner (x, y) of a rectangle [m]."""
BOUNDS_MARGIN = 0.05
"""An episode ends when the object's centre is this far outside the workspace [m]."""

_CELL = 0.01  # of the grid that decides whether a path exists [m]
_LOW, _SHAPE = (0.145, -0.455), (91, 91)  # its lower corner [m] and its cells
_BATCH = 256  # candidates drawn at a time
_BATCHES = 40
_LAYOUTS = 4


@dataclass(frozen=True, kw_only=True)
class Dynamics:
    """What the agent is not told about the pushed object."""

    mass: float = 1.0
    """[kg]"""
    friction: float = 0.5
    """Coefficient of the object's own material; that of the pair is the mean with the other's."""
    center_of_mass: tuple[float, float] = (0.0, 0.0)
    """Offset from the footprint's centroid, object frame [m]."""


@dataclass(frozen=True, kw_only=True)
class Scenario:
    """An episode's start: layout, object, goal and tool. Base frame, metres and radians."""

    scene: str
    difficulty: float
    obstacles: tuple[Obstacle, ...]
    pushed_object: str
    object_pose: tuple[float, float, float]
    """x, y, yaw"""
    goal_position: tuple[float, float]
    tool_pose: tuple[float, float, float]
    """x, y of the tip and its yaw"""
    dynamics: Dynamics = field(default_factory=Dynamics)

    def to_dict(self) -> dict[str, Any]:
        """Plain lists, numbers and strings, ready for JSON."""
        return asdict(self)

    @classmethod
    def from_dict(cls, data: dict[str, Any]) -> "Scenario":
        """Inverse of `to_dict`, also after a way through JSON.

        Raises:
            ValueError: If a field is missing or unknown; the message names it.
        """
        data = dict(data)
        expected = set(cls.__dataclass_fields__)
        if set(data) != expected:
            raise ValueError(
                f"Scenario: fields missing {sorted(expected - set(data))}, "
                f"unknown {sorted(set(data) - expected)}."
            )
        obstacles = tuple(Obstacle(tuple(o["size"]), tuple(o["pose"])) for o in data["obstacles"])
        dynamics = dict(data["dynamics"])
        dynamics["center_of_mass"] = tuple(dynamics["center_of_mass"])
        data.update(obstacles=obstacles, dynamics=Dynamics(**dynamics))
        for name in ("object_pose", "goal_position", "tool_pose"):
            data[name] = tuple(data[name])
        return cls(**data)


@dataclass(frozen=True, kw_only=True)
class ScenarioConfig:
    """What to draw episodes from."""

    scene: str | SceneFn | Sequence[str | SceneFn] = "free"
    """A family's name or function, or several: one is drawn per episode."""
    pushed_object: str | PushedObject | Sequence[str | PushedObject] = "small_cube"
    """An object or its name, or several: one is drawn per episode."""
    difficulty: float | tuple[float, float] = (0.0, 1.0)
    """Of the scene, a number or a range drawn from uniformly."""
    distance: tuple[float, float] = (0.2, 0.6)
    """Range of the distance from start to goal [m]."""
    low: tuple[float, float] = (0.20, -0.35)
    """Lower corner of the workspace [m]."""
    high: tuple[float, float] = (0.75, 0.35)
    """Upper corner of the workspace [m]."""
    max_start_radius: float = 0.80
    """Starts farther from the robot's axis are not drawn: the tool could not stand behind them [m]."""
    max_goal_radius: float = 0.82
    """The same for goals [m]."""
    clearance: float = 0.06
    """Least distance of start and goal from obstacles, surface to surface [m]."""
    path_margin: float = 0.04
    """How far out of the workspace the object's way to the goal may lead; at 5 cm an episode ends
    [m]."""
    tool_distance: tuple[float, float] = (0.08, 0.14)
    """Range of the distance from the object's centre to the tool's tip at the start [m]."""
    randomize_dynamics: bool = False
    """Draw mass, friction and centre of mass per episode."""
    mass: tuple[float, float] = (0.2, 2.0)
    """Range when dynamics are randomised [kg]; log-uniform."""
    friction: tuple[float, float] = (0.2, 0.8)
    """Range when dynamics are randomised, of the object's own material."""
    center_of_mass: float = 0.01
    """Largest offset per axis when dynamics are randomised [m]."""

    def __post_init__(self) -> None:
        """Check names and ranges, so that nothing fails at the thousandth reset."""
        if not self.scenes:
            raise ValueError("ScenarioConfig: scene is empty, expected at least one family.")
        if not self.objects:
            raise ValueError("ScenarioConfig: pushed_object is empty, expected at least one.")
        ranges: dict[str, tuple[tuple[float, float], float, float]] = {
            "difficulty": (self.difficulty_range, 0.0, 1.0),
            "distance": (self.distance, 0.0, 2.0),
            "path_margin": ((self.path_margin, self.path_margin), 0.0, 1.0),
            "tool_distance": (self.tool_distance, 0.0, 1.0),
            "mass": (self.mass, 1e-3, 1e3),
            "friction": (self.friction, 0.0, 10.0),
        }
        for name, ((low, high), least, most) in ranges.items():
            if not least <= low <= high <= most:
                raise ValueError(
                    f"ScenarioConfig: {name} must be a range within [{least:g}, {most:g}], "
                    f"got ({low:g}, {high:g})."
                )
        if not all(lo < hi for lo, hi in zip(self.low, self.high, strict=True)):
            raise ValueError(f"ScenarioConfig: low must be < high, got {self.low} and {self.high}.")

    def bounds(self, margin: float = BOUNDS_MARGIN) -> Bounds:
        """Where the object's centre may be before an episode ends, base frame [m]."""
        (x0, y0), (x1, y1) = self.low, self.high
        return (x0 - margin, y0 - margin), (x1 + margin, y1 + margin)

    @property
    def scenes(self) -> list[tuple[str, SceneFn]]:
        """The families to draw from, by name and function."""
        scene = self.scene
        several = [scene] if isinstance(scene, str) or callable(scene) else list(scene)
        return [get_scene(one) for one in several]

    @property
    def objects(self) -> list[PushedObject]:
        """The objects to draw from."""
        item = self.pushed_object
        several = [item] if isinstance(item, str | PushedObject) else list(item)
        return [get_object(one) for one in several]

    @property
    def difficulty_range(self) -> tuple[float, float]:
        """Difficulty as a range."""
        if isinstance(self.difficulty, int | float):
            return float(self.difficulty), float(self.difficulty)
        return self.difficulty


def sample_scenario(
    rng: np.random.Generator,
    config: ScenarioConfig,
    *,
    tool_half_extents: tuple[float, float] = (0.032, 0.011),
    tool_radii: tuple[float, float] = (0.16, 0.885),
) -> Scenario:
    """Draw an episode's start.

    Start and goal keep their distance from obstacles, a path joins them on the grid inflated by the
    object's radius, and the tool stands free and within reach. The number of tries is bounded.

    Args:
        rng: Source of randomness; the result depends on nothing else.
        config: What to draw from.
        tool_half_extents: Half the tip's footprint [m].
        tool_radii: Least and largest distance of the tip from the robot's axis [m].

    Raises:
        ValueError: If no start is found; the message counts which condition failed how often.
    """
    scenes, objects = config.scenes, config.objects
    failed: Counter[str] = Counter()
    name = ""
    for _ in range(_LAYOUTS):
        name, scene = scenes[rng.integers(len(scenes))]
        item = objects[rng.integers(len(objects))]
        difficulty = float(rng.uniform(*config.difficulty_range))
        obstacles = scene(rng, difficulty)
        if len(obstacles) > MAX_OBSTACLES:
            raise ValueError(
                f"scene: {name!r} placed {len(obstacles)} obstacles, at most {MAX_OBSTACLES} fit."
            )
        free_cells = _Connectivity(obstacles, item.radius, config)
        for _ in range(_BATCHES):
            found = _try_batch(
                rng, config, obstacles, item, free_cells, tool_half_extents, tool_radii, failed
            )
            if found is not None:
                start, goal, tool = found
                return Scenario(
                    scene=name,
                    difficulty=difficulty,
                    obstacles=tuple(obstacles),
                    pushed_object=item.name,
                    object_pose=start,
                    goal_position=goal,
                    tool_pose=tool,
                    dynamics=_sample_dynamics(rng, config, item),
                )
    reasons = ", ".join(f"{reason}: {n}" for reason, n in failed.most_common())
    raise ValueError(
        f"sample_scenario: no start found in scene {name!r} after {_LAYOUTS} layouts of "
        f"{_BATCH * _BATCHES} tries each. Failed conditions: {reasons}."
    )


def _try_batch(
    rng: np.random.Generator,
    config: ScenarioConfig,
    obstacles: list[Obstacle],
    item: PushedObject,
    free_cells: "_Connectivity",
    tool_half_extents: tuple[float, float],
    tool_radii: tuple[float, float],
    failed: Counter[str],
) -> tuple[tuple[float, float, float], tuple[float, float], tuple[float, float, float]] | None:
    """The first of a batch of candidates that meets every condition, or None.

    Clearances are taken from circumscribed circles: a little more than asked for, never less.
    """
    n = _BATCH
    start = rng.uniform(config.low, config.high, (n, 2))
    yaw = rng.uniform(-np.pi, np.pi, n)
    goal = start + _polar(rng.uniform(*config.distance, n), rng.uniform(-np.pi, np.pi, n))
    tool_way = rng.uniform(*config.tool_distance, n)
    tool = start + _polar(tool_way, rng.uniform(-np.pi, np.pi, n))
    tool_yaw = rng.uniform(-np.pi / 2, np.pi / 2, n)
    tool_size = math.hypot(*tool_half_extents)
    limits = np.array(
        [
            *config.low,
            *config.high,
            config.max_start_radius,
            config.max_goal_radius,
            *tool_radii,
            item.radius + config.clearance,
            item.radius + tool_size + 0.002,
            tool_size + 0.005,
        ]
    )
    i, counts = _judge(start, goal, tool, tool_way, free_cells.turned, free_cells.labels, limits)
    if i < 0:
        failed.update(dict(zip(_CONDITIONS, counts.tolist(), strict=True)))
        return None
    return (
        (float(start[i, 0]), float(start[i, 1]), float(yaw[i])),
        (float(goal[i, 0]), float(goal[i, 1])),
        (float(tool[i, 0]), float(tool[i, 1]), float(tool_yaw[i])),
    )


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
)


@numba.njit(cache=True)
def _judge(start, goal, tool, tool_way, turned, labels, limits):  # type: ignore[no-untyped-def]
    """Index of the first candidate that meets every condition, or -1.

    With it how many failed which condition first, in the order of `_CONDITIONS`.
    """
    counts = np.zeros(9, np.int64)
    for i in range(len(start)):
        (sx, sy), (gx, gy), (tx, ty) = start[i], goal[i], tool[i]
        reach = math.sqrt(tx * tx + ty * ty)
        if math.sqrt(sx * sx + sy * sy) > limits[4]:
            counts[0] += 1
        elif not (limits[0] <= gx <= limits[2] and limits[1] <= gy <= limits[3]):
            counts[1] += 1
        elif math.sqrt(gx * gx + gy * gy) > limits[5]:
            counts[2] += 1
        elif nearest_rectangle(sx, sy, turned) < limits[8]:
            counts[3] += 1
        elif nearest_rectangle(gx, gy, turned) < limits[8]:
            counts[4] += 1
        elif reach < limits[6] or reach > limits[7]:
            counts[5] += 1
        elif tool_way[i] < limits[9]:
            counts[6] += 1
        elif nearest_rectangle(tx, ty, turned) < limits[10]:
            counts[7] += 1
        elif not _joined(sx, sy, gx, gy, labels):
            counts[8] += 1
        else:
            return i, counts
    return -1, counts


@numba.njit(cache=True)
def _joined(sx, sy, gx, gy, labels):  # type: ignore[no-untyped-def]
    """Whether a path joins two points; no labels mean that nothing stands in the way."""
    if len(labels) == 0:
        return True
    first = _label(sx, sy, labels)
    return first > 0 and first == _label(gx, gy, labels)


@numba.njit(cache=True)
def _label(x, y, labels):  # type: ignore[no-untyped-def]
    i, j = int((x - _LOW[0]) / _CELL), int((y - _LOW[1]) / _CELL)
    return labels[min(max(i, 0), _SHAPE[0] - 1), min(max(j, 0), _SHAPE[1] - 1)]


def _polar(radius: np.ndarray, angle: np.ndarray) -> np.ndarray:
    return radius[:, None] * np.stack([np.cos(angle), np.sin(angle)], -1)


def _sample_dynamics(
    rng: np.random.Generator, config: ScenarioConfig, item: PushedObject
) -> Dynamics:
    if not config.randomize_dynamics:
        return Dynamics(mass=item.mass)
    x, y = rng.uniform(-config.center_of_mass, config.center_of_mass, 2)
    return Dynamics(
        mass=float(np.exp(rng.uniform(*np.log(config.mass)))),
        friction=float(rng.uniform(*config.friction)),
        center_of_mass=(float(x), float(y)),
    )


class _Connectivity:
    """Which free places an object can be slid between without ending the episode: on a grid over
    what the camera sees, and hardly out of the workspace.
    """

    def __init__(self, obstacles: list[Obstacle], radius: float, config: ScenarioConfig) -> None:
        self.turned = turned_rectangles(rectangles(obstacles))
        """The obstacles, as `nearest_rectangle` reads them."""
        self.labels = np.zeros((0, 0), np.int32)
        """Equal positive labels are joined, `[91, 91]`; empty where nothing stands."""
        if obstacles:
            centers, margin = _cell_centers(), config.path_margin
            passable = obstacle_distance(centers, obstacles) > radius
            passable &= (centers >= np.subtract(config.low, margin)).all(-1)
            passable &= (centers <= np.add(config.high, margin)).all(-1)
            _, self.labels = cv2.connectedComponents(passable.astype(np.uint8), connectivity=4)


@functools.cache
def _cell_centers() -> np.ndarray:
    x, y = np.indices(_SHAPE)
    return np.array(_LOW) + (np.stack([x, y], -1) + 0.5) * _CELL
