"""Obstacles and contacts of a simulation on CUDA."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import sapien
import torch
from mani_skill.envs.scene import ManiSkillScene
from mani_skill.utils.structs import Actor, Articulation, Pose
from sapien import physx
from torch import Tensor

from modpush.envs.engines.base import CONTACT_KEYS
from modpush.envs.engines.sapien import bodies
from modpush.envs.scenes.layouts import BAR_SECTION, CUBE_SIDE
from modpush.envs.scenes.obstacle import OBSTACLE_COLOR, OBSTACLE_MASS, Obstacle
from modpush.geometry.shapes import box


class ObstaclePool:
    """Obstacles of scenes that bodies cannot be added to while they run, as in a GPU simulation.

    The pool has cubes, bars of 7 and 10 cm, and bars in steps of 5 cm. A layout's lengths are rounded
    to these, and `place` returns the layout that was placed. Unused obstacles are parked far away.
    """

    _SIZES = (
        *((CUBE_SIDE,) * 3 for _ in range(24)),
        *((length, BAR_SECTION, BAR_SECTION) for length in (0.07, 0.10) for _ in range(13)),  # hard
        *((0.05 * n, BAR_SECTION, BAR_SECTION) for n in range(3, 13) for _ in range(2)),
    )

    def __init__(
        self, scene: "ManiSkillScene", material: physx.PhysxMaterial, dynamic: bool
    ) -> None:
        self._num_envs = len(scene.sub_scenes)
        self._device = scene.device
        self._in_play: list[list[int]] = [[] for _ in range(self._num_envs)]
        self._poses = torch.tensor(
            [self._parked(slot) for slot in range(len(self._SIZES))],
            dtype=torch.float32,
            device=self._device,
        ).repeat(self._num_envs, 1, 1)  # [B, slots, 7]
        self.actors = [
            bodies.build_actor(
                scene,
                f"obstacle_{slot}",
                [box(*size, color=OBSTACLE_COLOR)],
                material,
                mass=OBSTACLE_MASS,
                pose=sapien.Pose(self._parked(slot)[:3]),
                kinematic=not dynamic,
            )
            for slot, size in enumerate(self._SIZES)
        ]

    def _parked(self, slot: int) -> list[float]:
        return [30.0 + 1.0 * (slot % 8), 1.0 * (slot // 8), self._SIZES[slot][2] / 2, 1, 0, 0, 0]

    def place(
        self, indices: Sequence[int], layouts: Sequence[Sequence[Obstacle]]
    ) -> list[tuple[Obstacle, ...]]:
        """Place layouts in the scenes of these indices; returns the layouts that were placed."""
        standing = []
        for i, layout in zip(indices, layouts, strict=True):
            self._in_play[i] = []
            for slot in range(len(self._SIZES)):
                self._poses[i, slot] = self._poses.new_tensor(self._parked(slot))
            placed = []
            for obstacle in layout:
                slot = self._nearest_slot(i, obstacle)
                self._in_play[i].append(slot)
                x, y, yaw = obstacle.pose
                size = self._SIZES[slot]
                self._poses[i, slot] = self._poses.new_tensor(
                    [x, y, size[2] / 2, math.cos(yaw / 2), 0, 0, math.sin(yaw / 2)]
                )
                placed.append(Obstacle(size, obstacle.pose))
            standing.append(tuple(placed))
        rows = torch.as_tensor(indices, device=self._device)
        for slot, actor in enumerate(self.actors):
            actor.set_pose(Pose.create(self._poses[rows, slot]))
        return standing

    def _nearest_slot(self, index: int, obstacle: Obstacle) -> int:
        """The free slot whose size is nearest."""
        taken = set(self._in_play[index])
        free = [slot for slot in range(len(self._SIZES)) if slot not in taken]
        error = {
            slot: sum(abs(a - b) for a, b in zip(self._SIZES[slot], obstacle.size, strict=True))
            for slot in free
        }
        best = min(error, key=error.__getitem__, default=None)
        if best is None or error[best] > 0.0251:
            raise ValueError(
                f"ObstaclePool: no body of about size {obstacle.size} m is left for scene {index}; "
                f"{len(taken)} are in play."
            )
        return best

    def transforms(self, index: int = 0) -> np.ndarray:
        """Position [m] and quaternion (w, x, y, z) of one scene's obstacles, `[n, 7]`."""
        rows = [self.actors[slot].pose.raw_pose[index].tolist() for slot in self._in_play[index]]
        return np.array(rows).reshape(-1, 7)


_NEAR_OBSTACLES = ("wrist_2", "wrist_3", "tool")  # links that can come down to an obstacle


class CudaContacts:
    """Reads the contacts of a batched GPU simulation at the end of a control step.

    A GPU simulation gives impulses only, so that a pair touches if it was pushed apart in the last
    substep. The obstacles stay the same bodies in all episodes.
    """

    def __init__(
        self,
        scene: ManiSkillScene,
        robot: Articulation,
        objects: Sequence[Actor],
        obstacles: Sequence[Actor],
    ) -> None:
        self._scene = scene
        self._links = [robot.links_map[name] for name in _NEAR_OBSTACLES]
        self._objects, self._obstacles = objects, obstacles
        self._query: Any = None
        self._rows_of_key: list[list[int]] = [[] for _ in CONTACT_KEYS[:3]]

    def flags(self) -> Tensor:
        """Contacts, `[num_envs, 6]` bool, in the order of `CONTACT_KEYS`."""
        scene = self._scene
        if not scene._gpu_sim_initialized:
            return torch.zeros(
                scene.num_envs, len(CONTACT_KEYS), dtype=torch.bool, device=scene.device
            )
        if self._query is None:
            self._query = self._make_query()
        scene.px.gpu_query_contact_pair_impulses(self._query)
        touching = self._query.cuda_impulses.torch().ne(0).any(-1)
        columns = [
            touching[torch.tensor(rows, device=scene.device)].view(scene.num_envs, -1).any(-1)
            for rows in self._rows_of_key
        ]
        return torch.stack([*columns, *columns], -1)

    def _make_query(self) -> Any:
        pairs: list[tuple[Any, Any]] = []
        for i in range(self._scene.num_envs):
            for key, pair in self._pairs(i):
                self._rows_of_key[key].append(len(pairs))
                pairs.append(pair)
        return self._scene.px.gpu_create_contact_pair_impulse_query(pairs)

    def _pairs(self, index: int) -> list[tuple[int, tuple[Any, Any]]]:
        """Every pair of one scene that may touch, with the index of its key."""
        links, objects, obstacles = (
            [body._bodies[index] for body in group]
            for group in (self._links, self._objects, self._obstacles)
        )
        return [
            *((0, (a, b)) for a in links for b in objects),
            *((1, (a, b)) for a in objects for b in obstacles),
            *((2, (a, b)) for a in links for b in obstacles),
        ]
