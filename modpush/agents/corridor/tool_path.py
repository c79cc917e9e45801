"""Room for the tool: off obstacles, behind the object, and on its way there.

None of this is in the authors' code, whose tool is a rod that may brush past anything; without it
a gripper stalls against the obstacles that the object is to pass.
"""

import numpy as np
import torch
from numba import njit
from numpy.typing import NDArray
from torch import Tensor

from modpush.agents.corridor.corridor import least_clearance
from modpush.geometry import Camera
from modpush.planners import Planner, point_along


@njit(cache=True, nogil=True)
def _clearance_at(distance: NDArray, u: int, v: int) -> float:
    i = min(max(u, 0), distance.shape[1] - 1)
    j = min(max(v, 0), distance.shape[0] - 1)
    return distance[j, i]


@njit(cache=True, nogil=True)
def away_from_obstacles(distance: NDArray, u: float, v: float) -> tuple[float, float, float]:
    """Where to go to get away from the nearest obstacle.

    Args:
        distance: `[H, W]` float32, to obstacles [cells].
        u: Column [px].
        v: Row [px].

    Returns:
        A unit vector (u, v), zero where there is no obstacle, and the distance [cells].
    """
    i, j = int(np.rint(u)), int(np.rint(v))
    here = _clearance_at(distance, i, j)
    if not np.isfinite(here):
        return 0.0, 0.0, np.inf
    du = _clearance_at(distance, i + 2, j) - _clearance_at(distance, i - 2, j)
    dv = _clearance_at(distance, i, j + 2) - _clearance_at(distance, i, j - 2)
    length = np.sqrt(du * du + dv * dv)
    if length < 1e-6:
        return 0.0, 0.0, here
    return du / length, dv / length, here


def clearances_at(distance: list[NDArray], position: Tensor, camera: Camera) -> Tensor:
    """How far obstacles are from a point of each scene, `[B]` [m]; the image's rim beyond it."""
    pixel = camera.project(position).round().int().tolist()
    cells = [_clearance_at(distance[b], u, v) for b, (u, v) in enumerate(pixel)]
    return torch.tensor(cells, dtype=position.dtype) * camera.cell_size


def repulsion(distance: list[NDArray], position: Tensor, reach: float, camera: Camera) -> Tensor:
    """A push away from obstacles that grows from 0 at `reach` to 1 at contact.

    Args:
        distance: For each scene `[H, W]` float32 [cells].
        position: `[B, 2]` (x, y) [m].
        reach: [m]; 0 for none at all.
        camera: The camera, whose pixels are the grid's cells.

    Returns:
        `[B, 2]`.
    """
    pixel = camera.project(position.double()).tolist()
    pushes = []
    for b, (u, v) in enumerate(pixel):
        du, dv, cells = away_from_obstacles(distance[b], u, v)
        share = max(0.0, 1.0 - cells * camera.cell_size / reach) if reach > 0 else 0.0
        pushes.append([-dv * share, -du * share])  # up in the image is +x, left is +y
    return torch.tensor(pushes, dtype=position.dtype).reshape(-1, 2)


def way_behind(
    planner: Planner,
    distance: list[NDArray],
    position: Tensor,
    target: Tensor,
    tool: Tensor,
    keep_off: Tensor,
    room: float,
    camera: Camera,
) -> Tensor:
    """Where the tool should go to get behind the object, past obstacles and the object itself.

    Args:
        planner: Plans the way.
        distance: For each scene `[H, W]` float32, to obstacles [cells].
        position: `[B, 2]` the object's (x, y) [m].
        target: `[B, 2]` where it is to be pushed [m].
        tool: `[B, 2]` [m].
        keep_off: `[B]` how far the tool's centre stays away from the object's [m].
        room: The same from obstacles [m].
        camera: The camera, whose pixels are the grid's cells.

    Returns:
        `[B, 2]` a point 2 cm further on the tool's way [m]; straight on where there is no way.
    """
    back = position - target
    back = back / back.norm(dim=-1, keepdim=True).clamp_min(1e-9)
    goal = camera.project(position + (keep_off[:, None] + 0.005) * back)
    here, centre = camera.project(tool), camera.project(position).numpy()
    v, u = np.ogrid[: camera.height, : camera.width]
    blocked = np.empty((len(distance), camera.height, camera.width), dtype=bool)
    for b, cells in enumerate(distance):
        away = (u - centre[b, 0]) ** 2 + (v - centre[b, 1]) ** 2
        blocked[b] = (cells <= room / camera.cell_size) | (
            away <= (float(keep_off[b]) / camera.cell_size) ** 2
        )
    paths = planner.plan(torch.from_numpy(blocked), here, goal)
    ahead = point_along(paths.waypoints, torch.full((len(here),), 0.02 / camera.cell_size))
    return camera.unproject(torch.where(paths.found[:, None], ahead, goal))


@njit(cache=True, nogil=True)
def turn_to_room(
    distance: NDArray,
    position: NDArray,
    target: NDArray,
    behind: float,
    room: float,
    forward: float,
    touch: float,
) -> tuple[float, float]:
    """Turn the target round the object until there is room for the tool behind it.

    An object beside a wall cannot be pushed straight off it; it can be pushed along it, a little
    outwards. The least turn wins, of at most 105 degrees to either side.

    Args:
        distance: `[H, W]` float32, to obstacles [cells].
        position: `[2]` the object's (u, v) [px].
        target: `[2]` (u, v) [px].
        behind: How far behind the object the tool stands [px].
        room: How far obstacles have to be from it there [cells].
        forward: Look so far ahead of the object [px].
        touch: Room that the object needs there, unless it has less already [cells].

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
        bu, bv = position[0] - tu / length * behind, position[1] - tv / length * behind
        if least_clearance(distance, bu, bv, bu, bv) < room:
            continue
        reach = min(forward, length) / length
        fu, fv = position[0] + tu * reach, position[1] + tv * reach
        if least_clearance(distance, position[0], position[1], fu, fv) < min(touch, here - 1.0):
            continue
        return position[0] + tu, position[1] + tv
    return target[0], target[1]


def make_room(
    distance: list[NDArray],
    position: Tensor,
    target: Tensor,
    radius: Tensor,
    contact: float,
    room: float,
    camera: Camera,
) -> Tensor:
    """`turn_to_room` for a batch, in metres.

    Args:
        distance: For each scene `[H, W]` float32 [cells].
        position: `[B, 2]` the object's (x, y) [m].
        target: `[B, 2]` [m].
        radius: `[B]` the object's [m].
        contact: The tool stands so far from the object's circumscribed circle when it pushes [m].
        room: How far obstacles have to be from it there [m].
        camera: The camera, whose pixels are the grid's cells.

    Returns:
        `[B, 2]` (x, y) [m].
    """
    places, targets = (camera.project(value.double()).numpy() for value in (position, target))
    cell = camera.cell_size
    turned = [
        turn_to_room(
            distance[b],
            places[b],
            targets[b],
            (size + contact) / cell,
            room / cell,
            0.05 / cell,
            size / cell,
        )
        for b, size in enumerate(radius.tolist())
    ]
    return camera.unproject(torch.tensor(turned, dtype=torch.float64)).to(position.dtype)
