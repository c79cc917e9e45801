"""Scene families with movable objects in the way, for `dynamic_obstacles=True`.

They stand in a row across the whole workspace, between its near and its far half. Four leave room to pass
between them, eight hardly do, and twelve have a second row beside the first: who takes them for fixed
obstacles often finds no path. The difficulty makes them longer, from 6 to 8 cm up to 7 to 9 cm.
"""

import functools
import math
from collections.abc import Callable

import numpy as np

from modpush.envs.scenes.obstacle import Obstacle

_ROW = 8  # objects in the first row at most
_LENGTH = 0.80  # of a row, up to 5 cm beyond the workspace on either side [m]
_TILT, _YAW = math.radians(6), math.radians(15)  # of a row, and of an object in it, at most
_ASIDE = 0.01  # by which an object stands beside its row at most [m]
_BETWEEN_ROWS = 0.09  # [m]


def movable_objects(rng: np.random.Generator, difficulty: float, *, count: int) -> list[Obstacle]:
    """Boxes of 6 to 9 by 4 to 5 cm, 4 to 8 cm high, in a row across the workspace, or in two.

    Args:
        rng: Source of randomness.
        difficulty: Makes the boxes longer.
        count: Number of boxes.
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
