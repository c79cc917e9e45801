"""Turning the target around the object until the tool has room behind it.

The authors' code has none of this: their tool is a rod that may brush past anything. Without it a
gripper stalls against the obstacles that the object is to pass.
"""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from modpush._kernels import njit
from modpush.agents.corridor.clearance import least_clearance


class RoomNeeded(NamedTuple):
    """Room that a push needs behind and ahead of the object."""

    behind: float
    """Distance behind the object at which the tool stands [px]."""
    tool: float
    """Distance that the tool keeps from obstacles there [cells]."""
    ahead: float
    """Distance ahead of the object that is checked [px]."""
    touch: float
    """Distance that the object keeps from obstacles there, unless it is closer already [cells]."""


@njit(nogil=True)
def turn_target(
    distance: NDArray[Any], position: NDArray[Any], target: NDArray[Any], room: RoomNeeded
) -> tuple[float, float]:
    """Turn the target round the object until there is room for the tool behind it.

    An object beside a wall cannot be pushed straight off it; it can be pushed along it, a little
    outwards. The least turn wins, of at most 105 degrees to either side.

    Args:
        distance: Distance of each cell to obstacles, `[H, W]` float32 [cells].
        position: Position of the object, `[2]` (u, v) [px].
        target: `[2]` (u, v) [px].
        room: Room that is needed.

    Returns:
        The target, turned; the target itself if no turn makes room.
    """
    du, dv = target[0] - position[0], target[1] - position[1]
    length = max(np.sqrt(du * du + dv * dv), 1e-9)
    here = least_clearance(distance, position[0], position[1], position[0], position[1])
    for k in range(15):
        angle = ((k + 1) // 2) * np.radians(15.0) * (1 if k % 2 else -1)
        c, s = np.cos(angle), np.sin(angle)
        tu, tv = c * du - s * dv, s * du + c * dv
        bu, bv = position[0] - tu / length * room.behind, position[1] - tv / length * room.behind
        if least_clearance(distance, bu, bv, bu, bv) < room.tool:
            continue
        reach = min(room.ahead, length) / length
        fu, fv = position[0] + tu * reach, position[1] + tv * reach
        if least_clearance(distance, position[0], position[1], fu, fv) < min(
            room.touch, here - 1.0
        ):
            continue
        return position[0] + tu, position[1] + tv
    return target[0], target[1]
