"""Drags on the page as places on the table."""

import math
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from viser import SceneNodeDragEvent


def ray_on_plane(
    eye: NDArray[np.float64], through: NDArray[np.float64], height: float
) -> NDArray[np.float64] | None:
    """Intersection of a ray with a horizontal plane.

    Args:
        eye: Origin of the ray, `[3]` [m].
        through: A point on it, `[3]` [m].
        height: Height of the plane [m].

    Returns:
        x and y, `[2]` [m]; None if the ray does not lead there.
    """
    way = through - eye
    if abs(way[2]) < 1e-9 or (height - eye[2]) / way[2] <= 0:
        return None
    return (eye + way * (height - eye[2]) / way[2])[:2]


def make_draggable(
    handle: Any,
    center: Callable[[], tuple[float, float, float]],
    move: Callable[[float, float], None],
    turn: Callable[[float], None] | None = None,
) -> None:
    """Let the left button drag something over the table, and turn it with shift held.

    Args:
        handle: The viser node that is grabbed.
        center: Its present x, y, yaw in the page's world [m, m, rad].
        move: Called with where its centre is dragged to [m].
        turn: Called with the yaw that it is turned to [rad].
    """
    grabbed: dict[int, tuple[NDArray[np.float64], float, float]] = {}

    def place(event: "SceneNodeDragEvent[Any]", height: float) -> NDArray[np.float64] | None:
        eye = np.array(event.client.camera.position)
        return ray_on_plane(eye, np.array(event.end_position), height)

    # `async`, since viser then keeps the events in their order.
    async def on_move(event: "SceneNodeDragEvent[Any]") -> None:
        x, y, _ = center()
        if event.phase == "start":
            start = np.array(event.start_position)
            grabbed[event.client_id] = start[:2] - (x, y), float(start[2]), 0.0
        offset, height, _ = grabbed.get(event.client_id, (np.zeros(2), 0.0, 0.0))
        if (point := place(event, height)) is not None:
            move(*(point - offset).tolist())

    async def on_turn(event: "SceneNodeDragEvent[Any]") -> None:
        x, y, yaw = center()
        start = np.array(event.start_position)
        if event.phase == "start":
            angle = math.atan2(start[1] - y, start[0] - x)
            grabbed[event.client_id] = start[:2], float(start[2]), yaw - angle
        _, height, offset = grabbed.get(event.client_id, (start[:2], 0.0, 0.0))
        if turn is not None and (point := place(event, height)) is not None:
            turn(math.atan2(point[1] - y, point[0] - x) + offset)

    handle.on_drag("left")(on_move)
    if turn is not None:
        handle.on_drag("left", modifier="shift")(on_turn)
