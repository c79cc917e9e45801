"""The cells of the set `hidden_dynamics`: shape, mass, centre of mass and friction of each episode.

Nothing but the shape can be seen. 8 shapes x 5 masses x 5 centres x 5 frictions, in an order in which the
first 200 episodes, and each 200 that follow, hold every pair of levels of two of the three hidden
properties once for each shape. Each shape has five starts, and every level of a property meets each of
them equally often.
"""

from typing import NamedTuple

from modpush.envs.scenes.objects import get_object
from modpush.envs.scenes.scenario import Dynamics

__all__ = ["HIDDEN_SHAPES", "NUM_CELLS", "HiddenCell", "hidden_cell"]

HIDDEN_SHAPES = (
    "small_cube",
    "large_cube",
    "box",
    "fragment",
    "random_24",
    "random_35",
    "random_19",
    "random_13",
)
"""Shapes: two cuboids, the box of the pose sets, the shard with a notch, and prisms with 3, 4, 5 and 6
corners."""
_MASSES = (0.25, 0.5, 1.0, 2.0, 4.0)  # [kg]
_FRICTIONS = (0.1, 0.3, 0.5, 0.7, 0.9)  # of the object's material
_CENTERS = ((0, 0), (1, 0), (-1, 0), (0, 1), (0, -1))  # in quarters of the object's sides
_LEVELS = 5
NUM_CELLS = len(HIDDEN_SHAPES) * _LEVELS**3
"""Number of cells."""
_DISTANCES = (0.2, 0.6)  # from start to goal, in equal steps over shapes and starts [m]


class HiddenCell(NamedTuple):
    """Shape, start, distance and hidden properties of an episode."""

    shape: int
    """Number of its shape."""
    start: int
    """Number of its start, of five for each shape."""
    distance: float
    """Distance from start to goal, which belongs to shape and start [m]."""
    dynamics: Dynamics
    """Mass, friction and centre of mass."""


def hidden_cell(number: int) -> HiddenCell:
    """The cell of an episode, by its number in [0, `NUM_CELLS`)."""
    turn, shape = divmod(number, len(HIDDEN_SHAPES))
    block, place = divmod(turn, _LEVELS**2)
    mass, center = divmod(place, _LEVELS)
    start = (mass + 2 * center) % _LEVELS
    share = (start * len(HIDDEN_SHAPES) + shape + 0.5) / (_LEVELS * len(HIDDEN_SHAPES))
    low, high = _DISTANCES
    sides = get_object(HIDDEN_SHAPES[shape]).sides
    x, y = (quarter * side / 4 for quarter, side in zip(_CENTERS[center], sides, strict=True))
    dynamics = Dynamics(
        mass=_MASSES[mass],
        friction=_FRICTIONS[(mass + center + block) % _LEVELS],
        center_of_mass=(x, y),
    )
    return HiddenCell(shape, start, low + share * (high - low), dynamics)
