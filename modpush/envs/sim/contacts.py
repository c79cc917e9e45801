"""Which bodies touched during a control step."""

import functools
from collections.abc import Sequence
from typing import Any

import torch
from mani_skill.envs.scene import ManiSkillScene
from mani_skill.utils.structs import Actor, Articulation
from torch import Tensor

from modpush.envs.sim.obstacle_bodies import ObstaclePool, ObstacleSwapper

__all__ = ["CONTACT_GAP", "CONTACT_KEYS", "CpuContacts", "CudaContacts"]

CONTACT_GAP = 0.001
"""Bodies whose surfaces are nearer than this count as touching [m]."""
CONTACT_KEYS = (
    "object_contact",
    "obstacle_contact",
    "tool_obstacle_contact",
    "object_contact_at_end",
    "obstacle_contact_at_end",
    "tool_obstacle_contact_at_end",
)
"""During a control step tool or arm touched the object; the object touched an obstacle; tool or arm
touched an obstacle; and the same three at the step's end."""

_AT_END = 3  # index of the first that is about the step's end
_ROBOT, _OBJECT, _OBSTACLE = 1, 2, 4
_KEY_OF_PAIR = {_ROBOT | _OBJECT: 0, _OBJECT | _OBSTACLE: 1, _ROBOT | _OBSTACLE: 2}
_SPECULATIVE_GAP = 0.005  # bodies that are farther apart than this do not touch, pushed or not [m]
_SAMPLES = 4  # contacts are read this many times per control step
_NEAR_OBSTACLES = ("wrist_2", "wrist_3", "tool")  # links that can come down to an obstacle


class CpuContacts:
    """Collects the contacts of a CPU simulation, which has one scene, over the substeps of a step.

    A pair touches if PhysX pushed it apart or if its gap is at most `CONTACT_GAP`. Contacts are read
    four times per control step.

    Args:
        scene: The scene.
        robot: Its robot.
        objects: The objects that may be pushed.
        obstacles: The obstacles, looked up again at every `reset`.
    """

    def __init__(
        self,
        scene: ManiSkillScene,
        robot: Articulation,
        objects: Sequence[Actor],
        obstacles: ObstacleSwapper | ObstaclePool,
    ) -> None:
        self.touched = [False] * len(CONTACT_KEYS)
        """What has touched since `clear`, in the order of `CONTACT_KEYS`."""
        self._scene, self._device = scene, scene.device
        self._obstacles = obstacles
        self._permanent: dict[Any, int] = {
            **{link._objs[0]: _ROBOT for link in robot.links},
            **{actor._bodies[0]: _OBJECT for actor in objects},
        }
        self._category = self._permanent

    def reset(self, env_idx: Tensor) -> None:
        """Forget what touched, and look up the obstacles of a new episode."""
        self.clear()
        obstacles = dict.fromkeys(self._obstacles.rigid_bodies(), _OBSTACLE)
        self._category = {**self._permanent, **obstacles}

    def clear(self) -> None:
        """Forget what touched."""
        self.touched = [False] * len(CONTACT_KEYS)

    @staticmethod
    @functools.cache
    def sampled_substeps(num_substeps: int) -> frozenset[int]:
        """The substeps, counted from 1, after which contacts are read."""
        return frozenset(round(num_substeps * (i + 1) / _SAMPLES) for i in range(_SAMPLES))

    def after_substep(self, substep: int, num_substeps: int) -> None:
        """Read the contacts if this is one of the sampled substeps."""
        if substep in self.sampled_substeps(num_substeps):
            self.read()

    def read(self) -> None:
        """Add the present contacts to `touched`, of which the latter half is about this look alone."""
        category, touched = self._category, self.touched
        touched[_AT_END:] = [False] * _AT_END
        for contact in self._scene.px.get_contacts():
            first, second = contact.bodies
            key = _KEY_OF_PAIR.get(category.get(first, 0) | category.get(second, 0))
            if key is None or touched[_AT_END + key]:
                continue
            if any(
                point.separation <= CONTACT_GAP
                or (point.separation <= _SPECULATIVE_GAP and point.impulse.any())
                for point in contact.points
            ):
                touched[key] = touched[_AT_END + key] = True

    def flags(self) -> Tensor:
        """What has touched, `[1, 6]` bool, in the order of `CONTACT_KEYS`."""
        return torch.tensor([self.touched], device=self._device)


class CudaContacts:
    """Reads the contacts of a batched GPU simulation at the end of a control step.

    A GPU simulation gives impulses only, so that a pair touches if it was pushed apart in the last
    substep.

    Args:
        scene: All scenes.
        robot: Their robots.
        objects: The objects that may be pushed.
        obstacles: The obstacles, which stay the same bodies in all episodes.
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
        self._rows_of_key: list[list[int]] = [[] for _ in CONTACT_KEYS[:_AT_END]]

    def reset(self, env_idx: Tensor) -> None:
        """Nothing: impulses are those of the last substep."""

    def clear(self) -> None:
        """Nothing: impulses are those of the last substep."""

    def after_substep(self, substep: int, num_substeps: int) -> None:
        """Nothing: impulses are read once, in `flags`."""

    def flags(self) -> Tensor:
        """What touches, `[num_envs, 6]` bool, in the order of `CONTACT_KEYS`."""
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
