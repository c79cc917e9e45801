"""Contacts between bodies during a control step."""

import math
from collections.abc import Sequence
from typing import Any

import torch
from mani_skill.envs.scene import ManiSkillScene
from mani_skill.utils.structs import Actor, Articulation
from torch import Tensor

from modpush.envs.engines.base import (
    CONTACT_GAP,
    CONTACT_KEYS,
    NAME_OF_PAIR,
    OBJECT,
    OBSTACLE,
    PAIRS,
    ROBOT,
    TABLE,
)
from modpush.envs.engines.sapien.obstacle_bodies import ObstacleSwapper

_AT_END = 3  # index of the first that is about the step's end
_KEY_OF_PAIR = {pair: key for key, pair in enumerate(PAIRS)}
_SPECULATIVE_GAP = 0.005  # bodies that are farther apart than this do not touch, pushed or not [m]


class CpuContacts:
    """Collects the contacts of a CPU simulation, which has one scene, over the substeps of a step.

    A pair touches if PhysX pushed it apart or if its gap is at most `CONTACT_GAP`. The obstacles are
    looked up again at every `reset`.
    """

    def __init__(
        self,
        scene: ManiSkillScene,
        robot: Articulation,
        objects: Sequence[Actor],
        obstacles: ObstacleSwapper,
    ) -> None:
        self.touched = [False] * len(CONTACT_KEYS)
        """Contacts since `clear`, in the order of `CONTACT_KEYS`."""
        self._scene, self._obstacles = scene, obstacles
        self._permanent: dict[Any, int] = {
            **{link._objs[0]: ROBOT for link in robot.links},
            **{actor._bodies[0]: OBJECT for actor in objects},
        }
        self._category = self._permanent

    def reset(self) -> None:
        """Forget what touched, and look up the obstacles of a new episode."""
        self.clear()
        obstacles = dict.fromkeys(self._obstacles.rigid_bodies(), OBSTACLE)
        self._category = {**self._permanent, **obstacles}

    def clear(self) -> None:
        """Forget what touched."""
        self.touched = [False] * len(CONTACT_KEYS)

    def read(self) -> None:
        """Add the present contacts to `touched`, of which the latter half is about this look alone."""
        category, touched = self._category, self.touched
        touched[_AT_END:] = [False] * _AT_END
        for contact in self._scene.px.get_contacts():
            first, second = contact.bodies
            key = _KEY_OF_PAIR.get(category.get(first, TABLE) | category.get(second, TABLE))
            if key is None or touched[_AT_END + key]:
                continue
            if any(
                point.separation <= CONTACT_GAP
                or (point.separation <= _SPECULATIVE_GAP and point.impulse.any())
                for point in contact.points
            ):
                touched[key] = touched[_AT_END + key] = True

    def gaps(self) -> dict[str, float]:
        """Smallest gap of each pair of bodies now [m], see `Engine.gaps`."""
        found = dict.fromkeys(NAME_OF_PAIR.values(), math.inf)
        for contact in self._scene.px.get_contacts():
            first, second = (self._category.get(body, TABLE) for body in contact.bodies)
            name = NAME_OF_PAIR.get(first | second)
            if name is not None:
                found[name] = min([found[name], *(point.separation for point in contact.points)])
        return found

    def flags(self) -> Tensor:
        """Contacts, `[1, 6]` bool, in the order of `CONTACT_KEYS`."""
        return torch.tensor([self.touched], device=self._scene.device)
