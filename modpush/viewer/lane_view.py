"""`LaneView`: one lane drawn on the page, from the primitives that physics uses, and its drags."""

import functools
import math
from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from modpush.envs.outcome import GOAL_THRESHOLD
from modpush.envs.scenes.drawing import COLORS
from modpush.envs.scenes.objects import get_object
from modpush.envs.scenes.rectangles import obstacle_distance
from modpush.envs.scenes.scenario import Scenario
from modpush.geometry.camera import CAMERA
from modpush.geometry.shapes import Primitive, box, cylinder
from modpush.geometry.workspace import WORKSPACE
from modpush.viewer.controls import assign
from modpush.viewer.lane import Snapshot
from modpush.viewer.overlays import Overlays, map_picture, path_segments, primitive_mesh
from modpush.viewer.session import Session

if TYPE_CHECKING:
    from viser import SceneNodeDragEvent, ViserServer


def ray_on_plane(
    eye: NDArray[np.float64], through: NDArray[np.float64], height: float
) -> NDArray[np.float64] | None:
    """Point `[2]` [m] where a ray from `eye` through a point, `[3]` each, meets a plane; None if none."""
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
    """Let the left button drag a viser node over the table, and turn it with shift held.

    `center` gives its x, y, yaw in the page's world [m, m, rad]; `move` and `turn` get the new ones.
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


_TABLE = box(1.20, 1.20, 0.02, (0.30, 0.0, -0.011), color=(0.90, 0.88, 0.84))
_GOAL = cylinder(GOAL_THRESHOLD, 0.004, (0.0, 0.0, 0.002), color=(0.24, 0.65, 0.30))
_OBSTACLE, _HIT = (0.30, 0.33, 0.38), (0.80, 0.15, 0.15)
_RED, _GREEN, _BLUE = COLORS["object"]
_OBJECT = (_RED / 255, _GREEN / 255, _BLUE / 255)  # of every object, as in the pictures
_MAGENTA = (200, 40, 190)
_SHORT = {
    "object_contact": "pushing",
    "obstacle_contact": "object hits obstacle",
    "tool_obstacle_contact": "tool hits obstacle",
    "success": "success",
    "out_of_bounds": "out of bounds",
}


class LaneView:
    """Draws a lane under the node `root`, and sends what is dragged to the session.

    Its robot stands at `offset` along the page's y [m].
    """

    def __init__(self, server: "ViserServer", session: Session, root: str, offset: float) -> None:
        self._scene, self._session, self._root = server.scene, session, root
        self._offset = offset
        self._shown: Snapshot | None = None
        self._scene.add_frame(root, show_axes=False, position=(0.0, offset, 0.0))
        self._body("table", (_TABLE,))
        corners = np.column_stack([WORKSPACE.corners(), np.full(4, 0.001)])
        edges = np.stack([corners, np.roll(corners, -1, axis=0)], 1)
        self._scene.add_line_segments(f"{root}/workspace", edges, (190, 182, 170), thickness=0.003)
        self._links: list[Any] = []
        self._goal: Any = None
        self._object: Any = None
        self._obstacles: list[Any] = []
        empty = path_segments(None, 0.0)
        self._path = self._scene.add_line_segments(f"{root}/path", empty, _MAGENTA, thickness=0.006)
        color = tuple(round(255 * c) for c in _OBSTACLE)
        self._patrols = self._scene.add_line_segments(
            f"{root}/patrols", empty, color, thickness=0.004
        )
        self._subgoal = self._scene.add_icosphere(f"{root}/subgoal", 0.012, _MAGENTA)
        side = CAMERA.width * CAMERA.cell_size
        self._map = self._scene.add_image(
            f"{root}/map",
            np.zeros((2, 2, 4), dtype=np.uint8),
            side,
            side,
            position=(CAMERA.x, CAMERA.y, 0.003),
            # Image right is the robot's right, image down is towards the robot.
            wxyz=(0.0, math.sqrt(0.5), -math.sqrt(0.5), 0.0),
            cast_shadow=False,
        )
        self._label = self._scene.add_label(
            f"{root}/label", "", position=(0.95, 0.0, 0.08), anchor="bottom-center"
        )

    def _body(
        self, name: str, parts: tuple[Primitive, ...], drag: Callable[[Any], None] | None = None
    ) -> Any:
        """A frame with the meshes of its parts."""
        frame = self._scene.add_frame(f"{self._root}/{name}", show_axes=False)
        for i, part in enumerate(parts):
            mesh = primitive_mesh(part)
            handle = self._scene.add_mesh_simple(
                f"{self._root}/{name}/{i}",
                mesh.vertices.astype(np.float32),
                mesh.faces.astype(np.uint32),
                color=part.color,
                flat_shading=part.kind in ("box", "prism"),
                side="double",
            )
            if drag is not None:
                drag(handle)
        return frame

    def _drag_goal(self, handle: Any) -> None:
        def pose() -> tuple[float, float, float]:
            scenario = self._session.snapshots[0].scenario
            x, y = scenario.goal_position
            return x, y + self._offset, scenario.goal_yaw or 0.0

        def move(x: float, y: float) -> None:
            move_goal = functools.partial(self._session.move_goal, x, y - self._offset)
            self._session.submit(move_goal, "goal")

        def turn(yaw: float) -> None:
            scenario = self._session.snapshots[0].scenario
            if scenario.goal_yaw is not None:
                turned = functools.partial(self._session.move_goal, *scenario.goal_position, yaw)
                self._session.submit(turned, "goal")

        make_draggable(handle, pose, move, turn)

    def _drag_obstacle(self, handle: Any, index: int) -> None:
        session = self._session

        def pose() -> tuple[float, float, float]:
            obstacles = session.snapshots[0].present.obstacles
            x, y, yaw = obstacles[index].pose if index < len(obstacles) else (0.0, 0.0, 0.0)
            return x, y + self._offset, yaw

        def move(x: float, y: float) -> None:
            command = functools.partial(session.move_obstacle, index, x, y - self._offset)
            session.submit(command, ("obstacle", index))

        def turn(yaw: float) -> None:
            x, y, _ = pose()
            command = functools.partial(session.move_obstacle, index, x, y - self._offset, yaw)
            session.submit(command, ("obstacle", index))

        make_draggable(handle, pose, move, turn)

    def update(self, shown: Snapshot, overlays: Overlays, name: str) -> None:
        """Bring the page up to a snapshot; what has not changed is not sent."""
        before = self._shown.scenario if self._shown is not None else None
        if before is not shown.scenario:
            self._rebuild(before, shown.scenario)
        item = get_object(shown.scenario.pushed_object)
        arm = shown.robot, shown.tool
        if self._shown is None or (self._shown.robot, self._shown.tool) != arm:
            for handle in self._links:
                handle.remove()
            shapes = [*(link.shapes for link in shown.robot.links), shown.tool.shapes]
            self._links = [self._body(f"arm/{i}", parts) for i, parts in enumerate(shapes)]
        transforms = shown.robot.link_transforms(shown.joint_position)
        for frame, transform in zip(self._links, transforms, strict=True):
            _place_matrix(frame, transform)
        _place(self._object, *shown.object_pose[:2], item.height / 2, shown.object_pose[2])
        _place(self._goal, *shown.scenario.goal_position, 0.0, shown.scenario.goal_yaw or 0.0)
        obstacles = shown.present.obstacles
        hit = _hit_obstacles(shown) if overlays.flags else set()
        for i, handle in enumerate(self._obstacles):
            obstacle = obstacles[i]
            x, y, yaw = obstacle.pose
            _place(handle, x, y, obstacle.size[2] / 2, yaw)
            color = _HIT if i in hit else _OBSTACLE
            assign(handle, "color", tuple(round(255 * c) for c in color))
        self._update_overlays(shown, overlays, name)
        self._shown = shown

    def _rebuild(self, before: Scenario | None, now: Scenario) -> None:
        """Make the bodies that a scenario has and the one before had not."""
        if before is None or before.pushed_object != now.pushed_object:
            if self._object is not None:
                self._object.remove()
            parts = get_object(now.pushed_object).parts
            self._object = self._body("object", tuple(replace(p, color=_OBJECT) for p in parts))
            if self._goal is not None:
                self._goal.remove()
            goal = (_GOAL,) if now.goal_yaw is None else tuple(_flat(part) for part in parts)
            self._goal = self._body("goal", goal, drag=self._drag_goal)
        patrols = [o.ends() for o in now.obstacles if o.motion is not None]
        lines = [path_segments(ends, 0.003) for ends in patrols] or [path_segments(None, 0.0)]
        self._patrols.points = np.concatenate(lines)
        sizes = [o.size for o in now.obstacles]
        if before is None or [o.size for o in before.obstacles] != sizes:
            for handle in self._obstacles:
                handle.remove()
            self._obstacles = []
            for i, size in enumerate(sizes):
                handle = self._scene.add_box(
                    f"{self._root}/obstacle{i}", dimensions=size, color=_OBSTACLE
                )
                self._drag_obstacle(handle, i)
                self._obstacles.append(handle)

    def _update_overlays(self, shown: Snapshot, overlays: Overlays, name: str) -> None:
        assign(self._path, "visible", overlays.path and shown.path is not None)
        if self._shown is None or shown.path is not self._shown.path:
            self._path.points = path_segments(shown.path, 0.006)
        assign(self._subgoal, "visible", overlays.subgoal and shown.subgoal is not None)
        if shown.subgoal is not None:
            _place(self._subgoal, *shown.subgoal, 0.012, 0.0)
        assign(self._map, "visible", overlays.map and shown.occupancy is not None)
        if overlays.map and shown.occupancy is not None:
            if self._shown is None or not np.array_equal(self._map_drawn, shown.occupancy):
                self._map.image = map_picture(shown.occupancy)
            self._map_drawn = shown.occupancy
        flags = [_SHORT[key] for key, value in shown.flags.items() if value]
        text = f"{name}, step {shown.step}"
        assign(self._label, "text", " | ".join([text, *flags]) if overlays.flags else text)

    _map_drawn: Any = None

    def remove(self) -> None:
        """Take the lane off the page."""
        self._scene.remove_by_name(self._root)


def _flat(part: Primitive) -> Primitive:
    """A part of an object as a flat mark on the table, in the goal's colour."""
    x, y, _ = part.position
    half = _GOAL.size[1]
    place: dict[str, Any] = {"position": (x, y, half), "color": _GOAL.color}
    if part.kind in ("cylinder", "capsule"):
        return replace(part, kind="cylinder", size=(part.size[0], half, 0.0), **place)
    return replace(part, size=(*part.size[:2], half), **place)


def _hit_obstacles(shown: Snapshot) -> set[int]:
    """Indices of the obstacles that are hit: what touches is known, and of the obstacles the nearest."""
    touching = {"obstacle_contact": shown.object_pose, "tool_obstacle_contact": shown.ee_pose}
    found = set()
    for flag, pose in touching.items():
        if shown.flags[flag] and shown.scenario.obstacles:
            place = np.array([pose[:2]])
            gaps = [float(obstacle_distance(place, [o])[0]) for o in shown.present.obstacles]
            found.add(int(np.argmin(gaps)))
    return found


def _place(handle: Any, x: float, y: float, z: float, yaw: float) -> None:
    assign(handle, "position", (x, y, z))
    assign(handle, "wxyz", (math.cos(yaw / 2), 0.0, 0.0, math.sin(yaw / 2)))


def _place_matrix(handle: Any, transform: np.ndarray) -> None:
    from transforms3d.quaternions import mat2quat

    assign(handle, "position", transform[:3, 3])
    assign(handle, "wxyz", mat2quat(transform[:3, :3]))
