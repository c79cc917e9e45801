"""Scene families with one obstacle of a shape, or two, a moving bar, and tracks of movable objects.

Those before the tracks are of arXiv 2403.17667, in which the obstacle stands between object and goal
(`ScenarioConfig.obstacle_between`). Sizes, shape and pose are drawn for each episode; the difficulty
scales the obstacle, from 0.8 to 1.2. Circle, cross, T and L are composed of boxes that overlap. The
sizes are our own: the paper gives none.
"""

import functools
import math
from collections.abc import Callable

import numpy as np

from modpush.envs.scenes.obstacle import Obstacle, Patrol
from modpush.geometry.workspace import WORKSPACE

_HEIGHT = 0.06  # that of a bar [m]
_CIRCLE_BOXES = 6
_SPEED = 0.1  # of the moving bar, that of the paper [m/s]
_APART = 0.14  # of two rectangles, between their circumscribed circles at most [m]

_Part = tuple[float, float, float, float, float]
"""Length, width, and x, y, yaw in the obstacle's own frame [m, rad]."""


def one_rectangle(rng: np.random.Generator, difficulty: float) -> list[Obstacle]:
    """A rectangle of 10 to 25 by 5 to 10 cm."""
    length, width = rng.uniform((0.10, 0.05), (0.25, 0.10))
    return _placed(rng, difficulty, [(length, width, 0.0, 0.0, 0.0)])


def one_circle(rng: np.random.Generator, difficulty: float) -> list[Obstacle]:
    """A circle with a radius of 4 to 7 cm, as a regular polygon with 12 corners.

    Six boxes over opposite sides of the polygon fill it; it lies up to 3 mm inside the circle.
    """
    radius, half_angle = rng.uniform(0.04, 0.07), math.pi / (2 * _CIRCLE_BOXES)
    length, width = 2 * radius * math.cos(half_angle), 2 * radius * math.sin(half_angle)
    yaws = [2 * half_angle * k for k in range(_CIRCLE_BOXES)]
    return _placed(rng, difficulty, [(length, width, 0.0, 0.0, yaw) for yaw in yaws])


def one_cross(rng: np.random.Generator, difficulty: float) -> list[Obstacle]:
    """Two bars of 12 to 22 cm, 4 to 6 cm wide, whose middles cross at a right angle."""
    width = rng.uniform(0.04, 0.06)
    first, second = rng.uniform(0.12, 0.22, 2)
    return _placed(
        rng, difficulty, [(first, width, 0.0, 0.0, 0.0), (second, width, 0.0, 0.0, math.pi / 2)]
    )


def one_t(rng: np.random.Generator, difficulty: float) -> list[Obstacle]:
    """A bar of 12 to 22 cm with a stem of 6 to 14 cm at its middle, both 4 to 6 cm wide."""
    width, length, stem = rng.uniform((0.04, 0.12, 0.06), (0.06, 0.22, 0.14))
    # The stem begins inside the bar, so that there is no seam.
    return _placed(
        rng,
        difficulty,
        [(length, width, 0.0, 0.0, 0.0), (stem + width, width, 0.0, -stem / 2, math.pi / 2)],
    )


def one_l(rng: np.random.Generator, difficulty: float) -> list[Obstacle]:
    """Two legs of 10 to 20 cm, 4 to 6 cm wide, that meet at a right angle at their ends."""
    width, first, second = rng.uniform((0.04, 0.10, 0.10), (0.06, 0.20, 0.20))
    # The corner's square, the frame's origin, belongs to both.
    return _placed(
        rng,
        difficulty,
        [
            (first, width, (first - width) / 2, 0.0, 0.0),
            (second, width, 0.0, (second - width) / 2, math.pi / 2),
        ],
    )


def two_rectangles(rng: np.random.Generator, difficulty: float) -> list[Obstacle]:
    """Two rectangles of 10 to 18 by 5 to 10 cm, up to 14 cm apart, that do not overlap."""
    first, second = (rng.uniform((0.10, 0.05), (0.18, 0.10)) for _ in range(2))
    apart = (math.hypot(*first) + math.hypot(*second)) / 2 + rng.uniform(0.0, _APART)
    yaws = rng.uniform(-math.pi, math.pi, 2)
    sides = zip((first, second), (-apart / 2, apart / 2), yaws, strict=True)
    return _placed(rng, difficulty, [(*size, x, 0.0, yaw) for size, x, yaw in sides])


def moving_bar(rng: np.random.Generator, difficulty: float) -> list[Obstacle]:
    """The rectangle of `one_rectangle`, which moves along y at 0.1 m/s, first to either side.

    It reverses when its centre is at the workspace's edge. Start, goal and path keep clear of where it is
    at the start alone.
    """
    (bar,) = one_rectangle(rng, difficulty)
    side, y = rng.choice((-1.0, 1.0)), bar.pose[1]
    ahead, behind = (float(WORKSPACE.high[1] - direction * y) for direction in (side, -side))
    patrol = Patrol(velocity=(0.0, float(side * _SPEED)), ahead=ahead, behind=behind)
    return [Obstacle(bar.size, bar.pose, patrol)]


def _placed(rng: np.random.Generator, difficulty: float, parts: list[_Part]) -> list[Obstacle]:
    """An obstacle's boxes, scaled, at any yaw near the middle of the workspace."""
    scale = 0.8 + 0.4 * difficulty
    x, y, yaw = rng.uniform((0.40, -0.15, -math.pi), (0.55, 0.15, math.pi))
    c, s = math.cos(yaw), math.sin(yaw)
    return [
        Obstacle(
            (float(scale * length), float(scale * width), _HEIGHT),
            (
                float(x + scale * (c * u - s * v)),
                float(y + scale * (s * u + c * v)),
                float(math.remainder(yaw + turn, 2 * math.pi)),
            ),
        )
        for length, width, u, v, turn in parts
    ]


SHAPE_SCENES: dict[str, Callable[[np.random.Generator, float], list[Obstacle]]] = {
    "one_rectangle": one_rectangle,
    "one_circle": one_circle,
    "one_cross": one_cross,
    "one_t": one_t,
    "one_l": one_l,
    "two_rectangles": two_rectangles,
    "moving_bar": moving_bar,
}
"""The families of this file by name."""

_ROW = 8  # objects in the first row at most
_LENGTH = 0.80  # of a row, up to 5 cm beyond the workspace on either side [m]
_TILT, _YAW = math.radians(6), math.radians(15)  # of a row, and of an object in it, at most
_ASIDE = 0.01  # by which an object stands beside its row at most [m]
_BETWEEN_ROWS = 0.09  # [m]


def movable_objects(rng: np.random.Generator, difficulty: float, *, count: int) -> list[Obstacle]:
    """Boxes of 6 to 9 by 4 to 5 cm, 4 to 8 cm high, in a row across the workspace, or in two.

    The difficulty makes them longer.
    """
    middle, tilt = rng.uniform(0.45, 0.50), rng.uniform(-_TILT, _TILT)
    side = rng.choice((-1.0, 1.0))
    placed = []
    for row, number in enumerate((min(count, _ROW), max(count - _ROW, 0))):
        sizes = rng.uniform((0.06, 0.04, 0.04), (0.08, 0.05, 0.08), (number, 3))
        sizes[:, 0] += 0.01 * difficulty
        turns = rng.uniform(-_YAW, _YAW, number)
        along = sizes[:, 0] * np.cos(turns) + sizes[:, 1] * np.abs(np.sin(turns))
        gaps = (_LENGTH - along.sum()) * rng.dirichlet(np.ones(number + 1))
        v = np.cumsum(along + gaps[:-1]) - along / 2 - _LENGTH / 2
        u = row * side * _BETWEEN_ROWS + rng.uniform(-_ASIDE, _ASIDE, number)
        x, y = (
            middle + u * math.cos(tilt) - v * math.sin(tilt),
            u * math.sin(tilt) + v * math.cos(tilt),
        )
        placed += list(
            zip(sizes.tolist(), x.tolist(), y.tolist(), (turns + tilt).tolist(), strict=True)
        )
    return [Obstacle(tuple(size), (x, y, yaw + math.pi / 2)) for size, x, y, yaw in placed]


TRACK_SCENES: dict[str, Callable[[np.random.Generator, float], list[Obstacle]]] = {
    f"movable_{count}": functools.partial(movable_objects, count=count) for count in (4, 8, 12)
}
"""The families of this file by name."""
