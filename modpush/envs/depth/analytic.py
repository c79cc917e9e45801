"""`AnalyticDepthCamera`, computed from the known shapes, and the depth cameras by name."""

import sys
from typing import Any

import numpy as np
from numpy.typing import NDArray

from modpush.envs.depth.base import DepthCamera, DepthCameraFactory, SceneView
from modpush.envs.depth.raycast import Solids, blank_image, draw, warmup
from modpush.geometry.camera import CAMERA, Label
from modpush.geometry.shapes import box
from modpush.parts import find_part


class ImageMemory:
    """Arrays for a batch of images, used again once the images in them are released.

    Allocated again in every step, 2.5 MiB for eight scenes, they cost more (in page
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


Placed = tuple[Solids, NDArray[np.float64], int]
"""Solids, their poses and their label, as `raycast.draw` takes them."""


class AnalyticDepthCamera(DepthCamera):
    """Casts rays at the known shapes. Obstacles that cannot move are drawn once per episode.

    Args:
        scenes: Scenes that the camera sees.
        arm_in_depth: True if the camera sees the arm.
    """

    def __init__(self, scenes: SceneView, arm_in_depth: bool = False) -> None:
        super().__init__(scenes, arm_in_depth)
        warmup()
        self._objects = {item.name: Solids.of(item.parts) for item in scenes.pushed_objects}
        self._background = [blank_image() for _ in range(scenes.num_envs)]
        self._movable: list[tuple[Solids, NDArray[np.int64]] | None] = [None] * scenes.num_envs
        if arm_in_depth:
            shapes = {link.name: link.shapes for link in scenes.robot.links}
            shapes["tool"] = scenes.tool.shapes
            self._link_names = tuple(shapes)
            self._robot = Solids.of(part for parts in shapes.values() for part in parts)
            counts = [len(parts) for parts in shapes.values()]
            self._link_of_part = np.repeat(np.arange(len(shapes)), counts)

    def reset(self, index: int) -> None:
        """Draw the table and the obstacles that cannot move."""
        depth, labels = self._background[index]
        depth.fill(CAMERA.z)
        labels.fill(Label.TABLE)
        obstacles, any_moves = self.scenes.scenarios[index].obstacles, self.scenes.dynamic_obstacles
        moves = np.array([any_moves or o.motion is not None for o in obstacles], dtype=bool)
        movable, fixed = np.flatnonzero(moves), np.flatnonzero(~moves)
        self._movable[index] = (self._boxes(index, movable), movable) if len(movable) else None
        if len(fixed):
            poses = self.scenes.obstacle_transforms_of(index)[fixed]
            draw(depth, labels, self._boxes(index, fixed), poses, Label.OBSTACLE)

    def capture(
        self, index: int, depth: NDArray[np.float32], segmentation: NDArray[np.uint8]
    ) -> None:
        """Draw the moving bodies over the fixed ones."""
        behind, labels = self._background[index]
        np.copyto(depth, behind)
        np.copyto(segmentation, labels)
        for solids, poses, label in self._moving(index):
            draw(depth, segmentation, solids, poses, label)

    def _moving(self, index: int) -> list[Placed]:
        """The bodies that are drawn again in every image: solids, poses, label."""
        scenes = self.scenes
        name = scenes.scenarios[index].pushed_object
        pose = scenes.object_transform_of(index)[None]
        groups: list[Placed] = [(self._objects[name], pose, Label.OBJECT)]
        if (movable := self._movable[index]) is not None:
            solids, rows = movable
            groups.append((solids, scenes.obstacle_transforms_of(index)[rows], Label.OBSTACLE))
        if self.arm_in_depth:
            poses = scenes.link_transforms_of(index, self._link_names)[self._link_of_part]
            groups.append((self._robot, poses, Label.ROBOT))
        return groups

    def _boxes(self, index: int, rows: NDArray[np.int64]) -> Solids:
        obstacles = self.scenes.scenarios[index].obstacles
        return Solids.of(box(*obstacles[i].size) for i in rows)


DEPTH_CAMERAS: dict[str, DepthCameraFactory | str] = {
    "analytic": AnalyticDepthCamera,
    "sapien": "modpush.envs.engines.sapien.rendered_camera:RenderedDepthCamera",
}
"""The shipped depth cameras by name, or where they are."""


def find_depth_camera(depth: str | DepthCameraFactory) -> DepthCameraFactory:
    """Factory of a depth camera, by name, by `"module:name"`, or passed through.

    Raises:
        ValueError: If there is no such camera (the known ones are listed), or if it cannot be called.
    """
    found: Any = find_part("depth", find_part("depth", depth, DEPTH_CAMERAS), {})
    if not callable(found):
        raise ValueError(
            f"PushEnv: depth must be a DepthCamera's class or a function (scenes, arm_in_depth) -> "
            f"DepthCamera, got {found!r}."
        )
    return found
