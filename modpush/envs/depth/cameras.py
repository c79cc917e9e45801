"""The bird's-eye depth cameras: one interface, cast from the known shapes or rendered."""

import sys
from abc import ABC, abstractmethod
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
import sapien
from numpy.typing import NDArray

from modpush.envs.depth.raycast import (
    Solids,
    blank_image,
    cast_pixels,
    draw,
    warmup,
)
from modpush.envs.robot.ur5_2f85 import LINKS
from modpush.envs.sim.obstacle_bodies import obstacle_part
from modpush.envs.sim.rendering import NO_RENDERER, camera_pose
from modpush.geometry.camera import CAMERA
from modpush.geometry.labels import Label

if TYPE_CHECKING:
    from modpush.envs.sim.task import ClutterPushEnv

__all__ = [
    "AnalyticDepthCamera",
    "DepthCamera",
    "DepthName",
    "ImageMemory",
    "RenderedDepthCamera",
    "make_depth_camera",
]

DepthName = Literal["analytic", "sapien"]
Placed = tuple[Solids, NDArray[np.float64], int]
"""Solids, their poses and their label, as `raycast.draw` takes them."""


class DepthCamera(ABC):
    """Looks at the scenes of one task. `reset` when a scene's layout changes, then `capture`."""

    def __init__(self, task: "ClutterPushEnv", arm_in_depth: bool) -> None:
        self.task = task
        self.arm_in_depth = arm_in_depth

    @abstractmethod
    def reset(self, index: int) -> None:
        """Look anew at what stands still in scene `index`."""

    @abstractmethod
    def capture(
        self, index: int, depth: NDArray[np.float32], segmentation: NDArray[np.uint8]
    ) -> None:
        """Write the present image of scene `index` into `[H, W]` arrays [m] and labels."""


class AnalyticDepthCamera(DepthCamera):
    """Casts rays at the known shapes. Fixed obstacles are drawn once an episode."""

    def __init__(self, task: "ClutterPushEnv", arm_in_depth: bool = False) -> None:
        super().__init__(task, arm_in_depth)
        warmup()
        self._objects = {item.name: Solids.of(item.parts) for item in task.pushed_objects}
        self._background = [blank_image() for _ in range(task.num_envs)]
        self._fixed: list[list[Placed]] = [[] for _ in range(task.num_envs)]
        shapes = {link.name: link.shapes for link in LINKS} | {"tool": task.agent.tool.shapes}
        self._link_names = tuple(shapes)
        self._robot = Solids.of(part for parts in shapes.values() for part in parts)
        self._link_of_part = np.repeat(np.arange(len(shapes)), [len(p) for p in shapes.values()])

    def reset(self, index: int) -> None:
        """Draw the table and, where they are fixed, the obstacles."""
        depth, labels = self._background[index]
        depth.fill(CAMERA.z)
        labels.fill(Label.TABLE)
        self._fixed[index] = [] if self.task.dynamic_obstacles else [self._obstacles(index)]
        for solids, poses, label in self._fixed[index]:
            draw(depth, labels, solids, poses, label)

    def capture(
        self, index: int, depth: NDArray[np.float32], segmentation: NDArray[np.uint8]
    ) -> None:
        """Draw what moves over what stands."""
        behind, labels = self._background[index]
        np.copyto(depth, behind)
        np.copyto(segmentation, labels)
        for solids, poses, label in self._moving(index):
            draw(depth, segmentation, solids, poses, label)

    def cast(
        self, index: int, pixels: NDArray[np.float64]
    ) -> tuple[NDArray[np.float32], NDArray[np.uint8]]:
        """Depth and label at single pixels `[..., 2]` (u, v), without an image."""
        return cast_pixels(pixels, self._moving(index) + self._fixed[index])

    def _moving(self, index: int) -> list[Placed]:
        """What has to be drawn anew in every image: solids, poses, label."""
        task = self.task
        name = task.scenarios[index].pushed_object
        pose = task.object_transform_of(index)[None]
        groups: list[Placed] = [(self._objects[name], pose, Label.OBJECT)]
        if task.dynamic_obstacles:
            groups.append(self._obstacles(index))
        if self.arm_in_depth:
            poses = task.link_transforms_of(index, self._link_names)[self._link_of_part]
            groups.append((self._robot, poses, Label.ROBOT))
        return groups

    def _obstacles(self, index: int) -> Placed:
        obstacles = self.task.scenarios[index].obstacles
        solids = Solids.of(obstacle_part(o) for o in obstacles)
        return solids, self.task.obstacles.transforms(index), Label.OBSTACLE


class ImageMemory:
    """Arrays for a batch of images, used again as soon as nobody holds the images in them.

    Asked of the system anew for every step, 2.5 MiB for eight scenes, they cost more (in page
    faults) than what is drawn into them. `torch.from_numpy` keeps its array alive for as long as a
    tensor on the same memory lives, so the arrays' reference counts tell.
    """

    _KEPT = 4  # beyond these, arrays come from the system and go back to it

    def __init__(self, num_envs: int) -> None:
        self._shape = (num_envs, 1, CAMERA.height, CAMERA.width)
        self._arrays: list[tuple[NDArray[np.float32], NDArray[np.uint8]]] = []
        self._free = self._count(self._new())

    def _new(self) -> tuple[NDArray[np.float32], NDArray[np.uint8]]:
        return np.empty(self._shape, np.float32), np.empty(self._shape, np.uint8)

    @staticmethod
    def _count(pair: tuple[NDArray[np.float32], NDArray[np.uint8]]) -> tuple[int, int]:
        return sys.getrefcount(pair[0]), sys.getrefcount(pair[1])

    def take(self) -> tuple[NDArray[np.float32], NDArray[np.uint8]]:
        """Depth and segmentation to write into, `[B, 1, H, W]` each; make tensors of them at once."""
        for pair in self._arrays:
            if self._count(pair) == self._free:
                return pair
        pair = self._new()
        if len(self._arrays) < self._KEPT:
            self._arrays.append(pair)
        return pair


class RenderedDepthCamera(DepthCamera):
    """SAPIEN's own rendered camera: slow without a GPU, and the guard of the analytic one.

    Raises:
        RuntimeError: If the task was built without a renderer.
    """

    def __init__(self, task: "ClutterPushEnv", arm_in_depth: bool = False) -> None:
        super().__init__(task, arm_in_depth)
        if not task.scene.can_render():
            raise RuntimeError(NO_RENDERER)
        self._cameras = [self._add_camera(scene) for scene in task.scene.sub_scenes]

    @staticmethod
    def _add_camera(scene: sapien.Scene) -> Any:
        # ManiSkill's cameras use another shader, whose depth is whole millimetres.
        sapien.render.set_camera_shader_dir("default")
        camera = scene.add_camera(
            "bird_eye_raw", CAMERA.width, CAMERA.height, CAMERA.field_of_view, near=0.01, far=10.0
        )
        camera.entity.pose = camera_pose(CAMERA)
        return camera

    def reset(self, index: int) -> None:
        """Nothing is kept between images."""

    def capture(
        self, index: int, depth: NDArray[np.float32], segmentation: NDArray[np.uint8]
    ) -> None:
        """Render."""
        task, camera = self.task, self._cameras[index]
        if task.gpu_sim_enabled:
            task.scene.px.sync_poses_gpu_to_cpu()
        task.hide_goal_marker()
        self._show_robot(index, self.arm_in_depth)
        task.scene.sub_scenes[index].update_render()
        camera.take_picture()
        np.copyto(depth, -camera.get_picture("Position")[..., 2])
        ids = camera.get_picture("Segmentation")[..., 1]
        segmentation[:] = Label.TABLE
        for label, entities in self._entities(index).items():
            segmentation[np.isin(ids, [entity.per_scene_id for entity in entities])] = label
        self._show_robot(index, True)

    def _entities(self, index: int) -> dict[int, list[sapien.Entity]]:
        task = self.task
        name = task.scenarios[index].pushed_object
        return {
            Label.OBJECT: [task.objects.actors[name]._objs[index]],
            Label.OBSTACLE: task.obstacles.entities(index),
            Label.ROBOT: [link._objs[index].entity for link in task.agent.robot.links],
        }

    def _show_robot(self, index: int, visible: bool) -> None:
        for link in self.task.agent.robot.links:
            drawn = link._objs[index].entity.find_component_by_type(
                sapien.render.RenderBodyComponent
            )
            if drawn is not None:
                drawn.visibility = float(visible)


def make_depth_camera(
    name: DepthName, task: "ClutterPushEnv", arm_in_depth: bool = False
) -> DepthCamera:
    """The depth camera of this name.

    Raises:
        ValueError: If there is none; the message lists those there are.
    """
    cameras: dict[str, type[DepthCamera]] = {
        "analytic": AnalyticDepthCamera,
        "sapien": RenderedDepthCamera,
    }
    if name not in cameras:
        raise ValueError(f"depth: no camera {name!r}, expected one of {sorted(cameras)} or None.")
    return cameras[name](task, arm_in_depth)
