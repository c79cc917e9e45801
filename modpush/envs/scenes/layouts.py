"""Scene families: pure functions `(rng, difficulty) -> obstacles`.

All coordinates are in the robot's base frame; the authors' are turned by +90 degrees about z.
Source: paper Sec. V and the authors' released simulation.
"""

import math
from collections.abc import Callable

import numpy as np

from modpush.envs.scenes.obstacle import Obstacle
from modpush.envs.scenes.shape_layouts import SHAPE_SCENES, TRACK_SCENES
from modpush.geometry.workspace import WORKSPACE
from modpush.parts import find_part, part_name

BAR_SECTION = 0.06
"""Width and height of a bar [m]."""
CUBE_SIDE = 0.05
"""Side of an obstacle cube [m]."""

_CENTER = (0.475, 0.0)
_ACROSS = math.pi / 2  # a bar's long axis along y, across the way out from the robot


SceneFn = Callable[[np.random.Generator, float], list[Obstacle]]
"""`(rng, difficulty in [0, 1]) -> obstacles`. A layout with an obstacle where the arm's shoulder and
upper arm turn, 0.2 m around the robot's axis, is drawn again (`sample_scenario`)."""


def _bar(length: float, x: float, y: float, yaw: float) -> Obstacle:
    return Obstacle((length, BAR_SECTION, BAR_SECTION), (x, y, yaw))


def _cube(x: float, y: float, yaw: float = 0.0) -> Obstacle:
    return Obstacle((CUBE_SIDE, CUBE_SIDE, CUBE_SIDE), (x, y, yaw))


def _gap(difficulty: float) -> float:
    """Free gap, 20 cm at difficulty 0 and 10 cm at 1 [m]."""
    return 0.20 - 0.10 * difficulty


def free(rng: np.random.Generator, difficulty: float) -> list[Obstacle]:
    """Nothing but the table."""
    return []


def bar_across(rng: np.random.Generator, difficulty: float) -> list[Obstacle]:
    """(a) One bar, 10 to 60 cm, within 45 degrees of lying across."""
    yaw = _ACROSS + rng.uniform(-1, 1) * math.pi / 4
    return [_bar(0.10 + 0.50 * difficulty, *_CENTER, yaw)]


def bar_along(rng: np.random.Generator, difficulty: float) -> list[Obstacle]:
    """(b) One bar, 10 to 60 cm, within 45 degrees of pointing away from the robot."""
    yaw = rng.uniform(-1, 1) * math.pi / 4
    return [_bar(0.10 + 0.50 * difficulty, *_CENTER, yaw)]


def slot(rng: np.random.Generator, difficulty: float) -> list[Obstacle]:
    """(c) Two bars in line across, 40 cm each, with a gap between their ends."""
    offset = _gap(difficulty) / 2 + 0.20
    return [_bar(0.40, _CENTER[0], side * offset, _ACROSS) for side in (-1, 1)]


def posts(rng: np.random.Generator, difficulty: float) -> list[Obstacle]:
    """(d) Four cubes at the corners of a square, the gap between neighbours."""
    offset = (_gap(difficulty) + CUBE_SIDE) / 2
    return [_cube(0.45 + i * offset, j * offset) for i in (-1, 1) for j in (-1, 1)]


def corridor(rng: np.random.Generator, difficulty: float) -> list[Obstacle]:
    """(e) Two parallel bars across, 30 cm each, the gap between them."""
    offset = (_gap(difficulty) + BAR_SECTION) / 2
    return [_bar(0.30, 0.45 + side * offset, 0.0, _ACROSS) for side in (-1, 1)]


def zigzag(rng: np.random.Generator, difficulty: float) -> list[Obstacle]:
    """Two long bars across, shifted sideways, so that the way between them is an S."""
    offset = (_gap(difficulty) + BAR_SECTION) / 2
    return [_bar(0.60, 0.45 + side * offset, side * 0.15, _ACROSS) for side in (-1, 1)]


_AUTHORS_BAR = 0.10
"""Length of the short bars of the authors' hard scenes [m]."""
_WALLS = (
    (0.15, -0.475),
    (0.25, -0.375),
    (0.35, -0.275),
    (0.0, -0.575),
    (0.15, -0.675),
    (0.25, -0.775),
    (0.35, -0.875),
    (-0.15, -0.475),
    (-0.25, -0.375),
    (-0.35, -0.275),
    (-0.15, -0.675),
    (-0.25, -0.775),
    (-0.35, -0.875),
)
"""Centres of the short bars of the authors' case 11, in their coordinates [m]."""
_MAZE = (*_WALLS[:4], *_WALLS[10:])
"""Centres of the short bars of the authors' case 12, in their coordinates [m]."""
_MAZE_LONG = ((-0.15, -0.375), (0.15, -0.775))
"""Centres of the long oblique bars of the authors' case 12, in their coordinates [m]."""


def _wide_bar(difficulty: float) -> float:
    """Length of the short bars of the wider hard scenes, 6 to 8 cm [m]."""
    return 0.06 + 0.02 * difficulty


def _walls(length: float) -> list[Obstacle]:
    return [_bar(length, -y, x, _ACROSS) for x, y in _WALLS]


def _maze(length: float) -> list[Obstacle]:
    short = [_bar(length, -y, x, _ACROSS) for x, y in _MAZE]
    return short + [_bar(0.40, -y, x, _ACROSS + math.pi / 4) for x, y in _MAZE_LONG]


def diagonal_walls(rng: np.random.Generator, difficulty: float) -> list[Obstacle]:
    """Unseen and hard: thirteen short bars in two crossing diagonals (the authors' case 11).

    Where the diagonals cross, the 10 cm long bars leave 6.4 cm from corner to corner; elsewhere 4 cm.
    On a map inflated by half the small cube's side, 2.5 cm, a path leads through; on one inflated by
    the radius of its circumscribed circle, 3.5 cm, none does. The difficulty is not used.
    """
    return _walls(_AUTHORS_BAR)


def maze(rng: np.random.Generator, difficulty: float) -> list[Obstacle]:
    """Unseen and hard: a diagonal of short bars and two long oblique ones (the authors' case 12).

    As in `diagonal_walls` the short bars are 10 cm long, and the difficulty is not used.
    """
    return _maze(_AUTHORS_BAR)


def diagonal_walls_wide(rng: np.random.Generator, difficulty: float) -> list[Obstacle]:
    """Like `diagonal_walls` but easier: bars of 6 to 8 cm leave 9.8 to 8.1 cm at the crossing."""
    return _walls(_wide_bar(difficulty))


def maze_wide(rng: np.random.Generator, difficulty: float) -> list[Obstacle]:
    """Like `maze` but easier: its short bars are 6 to 8 cm long."""
    return _maze(_wide_bar(difficulty))


def diagonal_walls_turned(rng: np.random.Generator, difficulty: float) -> list[Obstacle]:
    """`diagonal_walls` turned by 90 degrees about where the diagonals cross, for tuning."""
    x, y = 0.575, 0.0
    return [
        Obstacle(wall.size, (x - (wall.pose[1] - y), y + (wall.pose[0] - x), 0.0))
        for wall in _walls(_AUTHORS_BAR)
    ]


def maze_mirrored(rng: np.random.Generator, difficulty: float) -> list[Obstacle]:
    """`maze` with left and right exchanged, for tuning."""
    return [
        Obstacle(bar.size, (bar.pose[0], -bar.pose[1], -bar.pose[2])) for bar in _maze(_AUTHORS_BAR)
    ]


def random_clutter(rng: np.random.Generator, difficulty: float) -> list[Obstacle]:
    """Ten cubes anywhere in the workspace, at any angle, 2 cm apart or more.

    The difficulty is not used.
    """
    centers = np.empty((0, 2))
    apart = CUBE_SIDE * math.sqrt(2) + 0.02
    while len(centers) < 10:
        tries = rng.uniform(WORKSPACE.low, WORKSPACE.high, (100, 2))
        distance = np.linalg.norm(tries[:, None] - centers, axis=-1).min(1, initial=np.inf)
        if (distance >= apart).any():
            centers = np.vstack([centers, tries[np.argmax(distance >= apart)]])
    yaws = rng.uniform(-np.pi, np.pi, len(centers))
    return [_cube(float(x), float(y), float(a)) for (x, y), a in zip(centers, yaws, strict=True)]


_NEAREST = 0.17
"""Least x of any point of a bar that is drawn at random [m]: nearer, the arm would stand in it."""


def _stands_clear(bar: Obstacle) -> bool:
    (length, width, _), (x, _, yaw) = bar.size, bar.pose
    return x - (abs(math.cos(yaw)) * length + abs(math.sin(yaw)) * width) / 2 >= _NEAREST


def narrow_gap(rng: np.random.Generator, difficulty: float) -> list[Obstacle]:
    """Two bars of 35 cm in line, anywhere and at many angles, with a gap of 12 to 8 cm between them.

    The closed gripper is 6.4 cm wide and has to follow the object through.
    """
    gap = 0.12 - 0.04 * difficulty * rng.uniform(0.5, 1.0)
    offset = gap / 2 + 0.175
    while True:  # more than every third try stands clear
        yaw = rng.uniform(-math.pi, math.pi)
        x, y = _CENTER[0] + rng.uniform(-0.08, 0.08), _CENTER[1] + rng.uniform(-0.2, 0.2)
        bars = [
            _bar(0.35, x + side * offset * math.cos(yaw), y + side * offset * math.sin(yaw), yaw)
            for side in (-1, 1)
        ]
        if all(map(_stands_clear, bars)):
            return bars


def random_bars(rng: np.random.Generator, difficulty: float) -> list[Obstacle]:
    """Three to nine bars of 6 to 30 cm anywhere in the workspace, near multiples of 45 degrees."""
    count = 3 + int(rng.integers(0, 2 + round(5 * difficulty)))
    bars: list[Obstacle] = []
    while len(bars) < count:  # most tries stand clear
        x, y = rng.uniform(WORKSPACE.low, WORKSPACE.high)
        yaw = rng.integers(4) * math.pi / 4 + rng.normal(0.0, 0.1)
        bar = _bar(rng.uniform(0.06, 0.30), float(x), float(y), float(yaw))
        if _stands_clear(bar):
            bars.append(bar)
    return bars


SCENES: dict[str, SceneFn] = {
    "free": free,
    "bar_across": bar_across,
    "bar_along": bar_along,
    "slot": slot,
    "posts": posts,
    "corridor": corridor,
    "zigzag": zigzag,
    "random_clutter": random_clutter,
    "diagonal_walls_wide": diagonal_walls_wide,
    "maze_wide": maze_wide,
    "narrow_gap": narrow_gap,
    "random_bars": random_bars,
}
"""The families by name in which the small objects can be pushed any distance. In `diagonal_walls_wide`
there may be no start of a large one, or of the fragment, more than 38 cm from a goal."""

TIGHT_SCENES: dict[str, SceneFn] = {
    "diagonal_walls": diagonal_walls,
    "maze": maze,
    "diagonal_walls_turned": diagonal_walls_turned,
    "maze_mirrored": maze_mirrored,
}
"""The families by name through whose passages only the inscribed circle of a small object fits: episodes
are drawn with `ScenarioConfig.path_inflation` `inscribed`, and planned with the same inflation."""

ALL_SCENES: dict[str, SceneFn] = {**SCENES, **TIGHT_SCENES, **SHAPE_SCENES, **TRACK_SCENES}
"""All families by name."""

OBSTACLE_SCENES = ("bar_across", "bar_along", "slot", "posts", "corridor")
"""The paper's five families for training and testing (Sec. V)."""
HARD_SCENES = ("diagonal_walls", "maze")
"""The paper's two unseen complex scenes, as its authors' released simulation builds them (Sec. V)."""
HARD_WIDE_SCENES = ("diagonal_walls_wide", "maze_wide")
"""The same with shorter bars, which leave wider gaps."""
HARD_TUNING_SCENES = ("zigzag", "random_clutter", "diagonal_walls_turned", "maze_mirrored")
"""Hard layouts which are not the paper's, to tune on."""


def get_scene(scene: str | SceneFn) -> tuple[str, SceneFn]:
    """Name and function of a scene family: by name, by `"module:function"`, or passed through.

    The name of a function of your own is `"module:function"`, by which it is found again; that of one
    which cannot be imported is the function's own.

    Raises:
        ValueError: If there is no such family (the known ones are listed), or if it is not a function.
    """
    if isinstance(scene, str) and scene in ALL_SCENES:
        return scene, ALL_SCENES[scene]
    found = find_part("scene", scene, ALL_SCENES)
    if not callable(found):
        raise ValueError(
            f"scene: {scene!r} is not a function (rng, difficulty) -> list[Obstacle], got {found!r}."
        )
    try:
        return part_name("scene", scene, ALL_SCENES), found
    except ValueError:
        return getattr(found, "__name__", type(found).__name__), found
