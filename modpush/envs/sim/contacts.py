"""Who touched whom during a control step."""

import functools
from typing import TYPE_CHECKING, Any

import torch
from torch import Tensor

if TYPE_CHECKING:
    from modpush.envs.sim.task import ClutterPushEnv

__all__ = ["CONTACT_GAP", "CONTACT_KEYS", "ContactReader"]

CONTACT_GAP = 0.001
"""Bodies this near count as touching [m] (spec 4)."""
CONTACT_KEYS = ("object_contact", "obstacle_contact", "tool_obstacle_contact")
"""Tool or arm touches the object; object touches an obstacle; tool or arm touches an obstacle."""

_ROBOT, _OBJECT, _OBSTACLE = 1, 2, 4
_KEY_OF_PAIR = {_ROBOT | _OBJECT: 0, _OBJECT | _OBSTACLE: 1, _ROBOT | _OBSTACLE: 2}
_SPECULATIVE_GAP = 0.005  # PhysX may push ahead of a touch; farther apart than this it does not [m]
_SAMPLES = 4  # times per control step that contacts are looked at
_NEAR_OBSTACLES = ("wrist_2", "wrist_3", "tool")  # links that can come down to an obstacle


class ContactReader:
    """Collects contacts over the substeps of a control step.

    On a CPU a pair touches if PhysX pushed it apart or its gap is at most 1 mm, looked at four times
    a step. On CUDA only impulses are to be had, at the end of the step.
    """

    def __init__(self, task: "ClutterPushEnv") -> None:
        self._task = task
        self._gpu = task.gpu_sim_enabled
        self._touched = torch.zeros(task.num_envs, len(CONTACT_KEYS), dtype=torch.bool)
        self._touched = self._touched.to(task.device)
        self._category: dict[Any, int] = {}
        self._query: Any = None
        self.row = [False] * len(CONTACT_KEYS)

    def clear(self, env_idx: Tensor | None = None) -> None:
        """Forget what touched. With scenes given, learn their bodies anew as well."""
        self.row = [False] * len(CONTACT_KEYS)
        if env_idx is None:
            self._touched.zero_()
            return
        self._touched[env_idx] = False
        if not self._gpu:
            self._category = {
                **self._lasting,
                **dict.fromkeys(self._task.obstacles.rigid_bodies(), _OBSTACLE),
            }

    @functools.cached_property
    def _lasting(self) -> dict[Any, int]:
        """Categories of the bodies that no episode changes."""
        links = [link._objs[0] for link in self._task.agent.robot.links]
        things = [actor._bodies[0] for actor in self._task._actors.values()]
        return {**dict.fromkeys(links, _ROBOT), **dict.fromkeys(things, _OBJECT)}

    @staticmethod
    @functools.cache
    def sample_at(num_substeps: int) -> frozenset[int]:
        """After which substeps, counted from 1, to call `read`."""
        return frozenset(round(num_substeps * (i + 1) / _SAMPLES) for i in range(_SAMPLES))

    def after_substep(self, substep: int, num_substeps: int) -> None:
        """Look at the contacts of a CPU scene where it is time to."""
        if not self._gpu and substep in self.sample_at(num_substeps):
            self.read()
            self._touched[0] = torch.tensor(self.row)

    def read(self) -> None:
        """Add the present contacts of a CPU scene to `row`."""
        category, row = self._category, self.row
        for contact in self._task.scene.px.get_contacts():
            first, second = contact.bodies
            key = _KEY_OF_PAIR.get(category.get(first, 0) | category.get(second, 0))
            if key is not None and not row[key]:
                row[key] = any(
                    point.separation <= CONTACT_GAP
                    or (point.separation <= _SPECULATIVE_GAP and point.impulse.any())
                    for point in contact.points
                )

    def flags(self) -> dict[str, Tensor]:
        """By key, `[num_envs]` bool."""
        if self._gpu:
            self._touched = self._read_gpu()
        return {key: self._touched[:, i].clone() for i, key in enumerate(CONTACT_KEYS)}

    def _read_gpu(self) -> Tensor:
        task = self._task
        if not task.scene._gpu_sim_initialized:
            return torch.zeros_like(self._touched)
        if self._query is None:
            pairs, self._pair_rows = [], [[], [], []]  # type: ignore[var-annotated]
            links = [task.agent.robot.links_map[name] for name in _NEAR_OBSTACLES]
            for i in range(task.num_envs):
                for key, pair in self._gpu_pairs(links, i):
                    self._pair_rows[key].append(len(pairs))
                    pairs.append(pair)
            self._query = task.scene.px.gpu_create_contact_pair_impulse_query(pairs)
        task.scene.px.gpu_query_contact_pair_impulses(self._query)
        touching = self._query.cuda_impulses.torch().ne(0).any(-1)
        columns = [
            touching[torch.tensor(rows, device=task.device)].view(task.num_envs, -1).any(-1)
            for rows in self._pair_rows
        ]
        return torch.stack(columns, -1)

    def _gpu_pairs(self, links: list[Any], index: int) -> list[tuple[int, tuple[Any, Any]]]:
        """Every pair of one scene that may touch, with the key it counts for."""
        task = self._task
        things = [actor._bodies[index] for actor in task._actors.values()]
        blocks = [actor._bodies[index] for actor in task.obstacles.actors]  # a pool, on CUDA
        arm = [link._bodies[index] for link in links]
        return [
            *((0, (a, b)) for a in arm for b in things),
            *((1, (a, b)) for a in things for b in blocks),
            *((2, (a, b)) for a in arm for b in blocks),
        ]
