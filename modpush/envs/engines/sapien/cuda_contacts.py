"""Contacts of a batched GPU simulation. Experimental: it has never been run."""

from collections.abc import Sequence
from typing import Any

import torch
from mani_skill.envs.scene import ManiSkillScene
from mani_skill.utils.structs import Actor, Articulation
from torch import Tensor

from modpush.envs.engines.base import CONTACT_KEYS

_NEAR_OBSTACLES = ("wrist_2", "wrist_3", "tool")  # links that can come down to an obstacle


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
