"""What the agent sees: the paper's observation, entry by entry, in a frame of choice."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import torch
from tensordict import NestedKey, TensorDict, TensorDictBase
from torch import Tensor
from torchrl.data import TensorSpec, Unbounded
from torchrl.envs import Transform

from modpush.geometry.angles import rotate, wrap_angle
from modpush.geometry.frames import Frame, check_frame, frame_yaw
from modpush.geometry.workspace import WORKSPACE, Rectangle

__all__ = ["ENTRIES", "PAPER_ENTRIES", "PATH_ENTRIES", "Entry", "PushObservation", "Seen"]


class Seen(NamedTuple):
    """What an entry may be made of, in the agent's frame with its origin at the object."""

    ee_position: Tensor
    """`[..., 2]` [m]"""
    ee_yaw: Tensor
    """`[..., 1]` [rad]"""
    object_yaw: Tensor
    """`[..., 1]` [rad]"""
    goal: Tensor
    """`[..., 2]` [m]"""
    subgoal: Tensor
    """`[..., 2]` [m]"""
    subgoal_past: Tensor
    """`[..., lags, 2]` [m], of earlier steps, in the present frame"""
    joint_position: Tensor
    """`[..., 6]` [rad]"""
    path_length: Tensor
    """`[..., 1]` [m]"""
    contact: Tensor
    """`[..., 1]` 0 or 1"""
    object_radius: Tensor
    """`[..., 1]` [m]"""
    latent: Tensor | None
    """`[..., d]` what the encoder says of the window, if there is one"""
    symmetry: int
    """How many yaw angles of the object look alike, 0 for all."""
    position: Tensor
    """`[..., 2]` [m], the object's in the base frame"""
    frame_yaw: Tensor
    """`[..., 1]` [rad], the agent's frame in the base frame"""
    bounds: tuple[Tensor, Tensor]
    """`[2]` [m] each, lower and upper corner of where the object may be, in the base frame"""


@dataclass(frozen=True)
class Entry:
    """One entry of the observation."""

    read: Callable[[Seen], Tensor]
    """`Seen -> [..., n]`, SI."""
    scale: float = 1.0
    """Multiplies it, so that it is of order 1."""
    shift: tuple[float, ...] = (0.0,)
    """Is subtracted before."""


def _ee_pose(seen: Seen) -> Tensor:
    # Pitch and roll against "tool down", where the controller keeps the tool.
    level = torch.zeros_like(seen.ee_yaw)
    return torch.cat([seen.ee_position, wrap_angle(seen.ee_yaw), level, level], -1)


def _ee_axis(seen: Seen) -> Tensor:
    angle = 2.0 * seen.ee_yaw  # the closed gripper looks the same from both sides
    return torch.cat([angle.cos(), angle.sin()], -1)


def _object_axis(seen: Seen) -> Tensor:
    angle = seen.symmetry * seen.object_yaw
    return torch.cat([angle.cos(), angle.sin()], -1)


def _edges(seen: Seen) -> Tensor:
    # Along each axis as far as the edge, whichever of the two edges in its way is met first.
    low, high = seen.bounds
    ahead = torch.cat([seen.frame_yaw.cos(), seen.frame_yaw.sin()], -1)
    left = torch.stack([-ahead[..., 1], ahead[..., 0]], -1)
    axes = torch.stack([ahead, left, -ahead, -left], -2)
    position = seen.position.unsqueeze(-2)
    room = torch.where(axes > 0, high - position, position - low)
    distance = (room / axes.abs().clamp_min(1e-6)).amin(-1)
    return (_EDGE_SEEN - distance).clamp(0.0, _EDGE_SEEN)


def _latent(seen: Seen) -> Tensor:
    if seen.latent is None:
        raise KeyError("PushObservation: entry 'latent' needs an encoder's latent, there is none.")
    return seen.latent


# The arm with its tool over the middle of the workspace [rad].
_HOME = (-0.25, -1.35, 2.0, -2.2, -1.57, 0.0)

# From how far the edge of the workspace is seen [m].
_EDGE_SEEN = 0.15

ENTRIES: dict[str, Entry] = {
    "latent": Entry(_latent, 0.5),
    "ee_pose": Entry(_ee_pose, 10.0),
    "ee_position": Entry(lambda seen: seen.ee_position, 10.0),
    "ee_axis": Entry(_ee_axis),
    "joint_position": Entry(lambda seen: seen.joint_position, 1.0, _HOME),
    "subgoal_past": Entry(lambda seen: seen.subgoal_past.flatten(-2), 5.0),
    "contact": Entry(lambda seen: seen.contact),
    "goal_distance": Entry(lambda seen: seen.goal.norm(dim=-1, keepdim=True), 3.0),
    "object_axis": Entry(_object_axis),
    "goal": Entry(lambda seen: seen.goal, 3.0),
    "subgoal": Entry(lambda seen: seen.subgoal, 5.0),
    "path_length": Entry(lambda seen: seen.path_length, 3.0),
    "edges": Entry(_edges, 1.0 / _EDGE_SEEN),
    "object_radius": Entry(lambda seen: seen.object_radius, 20.0),
}
"""By name. `ee_pose` is (x, y, yaw, pitch, roll); `ee_axis` and `object_axis` are cosine and sine of
the yaw times the symmetry of gripper and object. `edges` says how much nearer than 15 cm the edge is,
past which an episode ends, straight ahead, left, behind and right of the object: 0 to 0.15 m, 0 where it
is farther."""

PAPER_ENTRIES = (
    "latent",
    "ee_pose",
    "joint_position",
    "subgoal_past",
    "contact",
    "goal_distance",
)
"""The 49 values of the paper's table, with a latent of 32."""

PATH_ENTRIES = (
    "latent",
    "ee_position",
    "ee_axis",
    "joint_position",
    "subgoal_past",
    "contact",
    "goal_distance",
    "object_axis",
    "edges",
)
"""For `frame="path"`: the object's own yaw and the workspace's edges are added, angles are smooth; 54
with a latent of 32."""


class PushObservation(Transform):
    """Writes one flat observation: chosen entries, in a frame at the object, scaled to order 1.

    Args:
        frame: The axes: `"object"` (the paper), `"path"` or `"base"`; the origin is the object's.
        entries: Names of `ENTRIES` in their order, or pairs of a name and an `Entry` of your own;
            default `PATH_ENTRIES` in the path's frame, else `PAPER_ENTRIES`.
        symmetry: How many yaw angles of the object look alike (`PushedObject.symmetry`).
        bounds: Lower and upper corner of where the object may be, base frame [m], for the entry
            `edges` (`PushEnv.bounds`); by default those of the default workspace.
        raw: SI units instead of scaled values.
        keys: Other names for the keys read, by their default names: `object_pose` `[..., 3]`,
            `goal_position` `[..., 2]`, `ee_pose` `[..., 3]`, `joint_position` `[..., 6]`,
            `object_radius`, `object_contact`, `path_length` `[..., 1]`, `subgoal` `[..., 2]`,
            `subgoal_past` `[..., lags, 2]`, `latent` `[..., d]`; metres and radians, base frame.
        observation_key: Written, `[..., n]` float32.

    Raises:
        ValueError: If frame, entry or key is unknown; the message lists those there are. If a lower
            bound is no lower than its upper one.
        KeyError: If a key is missing.
    Source: table of observations in the paper's Sec. IV-B; spec 4.
    """

    READ = (
        *("object_pose", "goal_position", "ee_pose", "joint_position", "object_radius"),
        *("object_contact", "path_length", "subgoal", "subgoal_past"),
    )

    def __init__(
        self,
        frame: Frame = "object",
        *,
        entries: Sequence[str | tuple[str, Entry]] | None = None,
        symmetry: int = 4,
        bounds: Rectangle | None = None,
        raw: bool = False,
        keys: Mapping[str, NestedKey] | None = None,
        observation_key: NestedKey = "observation",
    ) -> None:
        check_frame("PushObservation", frame)
        if entries is None:
            entries = PATH_ENTRIES if frame == "path" else PAPER_ENTRIES
        self.frame = frame
        self.entries = _look_up(entries)
        self.symmetry = symmetry
        self.bounds = WORKSPACE.bounds() if bounds is None else bounds
        if not all(low < high for low, high in zip(*self.bounds, strict=True)):
            raise ValueError(
                f"PushObservation: bounds must be a lower and an upper corner, got {bounds}."
            )
        self.raw = raw
        names = (*self.READ, "latent") if "latent" in self.entries else self.READ
        if unknown := sorted(set(keys or {}) - {*self.READ, "latent"}):
            raise ValueError(
                f"PushObservation: keys has no {unknown}, expected some of {[*self.READ, 'latent']}."
            )
        self.keys: dict[str, NestedKey] = {name: (keys or {}).get(name, name) for name in names}
        self.observation_key = observation_key
        self.columns: dict[str, slice] = {}
        """Where each entry stands in the observation; known once one was made."""
        super().__init__(in_keys=list(self.keys.values()), out_keys=[observation_key])
        self._shift = self._scale = torch.empty(0)
        self._low, self._high = map(torch.tensor, self.bounds)

    def _call(self, next_tensordict: TensorDictBase) -> TensorDictBase:
        seen = self._see(next_tensordict)
        parts = []
        for name, entry in self.entries.items():
            try:
                value = entry.read(seen)
            except RuntimeError as error:
                raise RuntimeError(f"PushObservation: entry {name!r} failed: {error}") from error
            parts.append(value)
        observation = torch.cat(parts, -1)
        if not self.columns:
            self._lay_out(parts)
        if not self.raw:
            self._shift, self._scale = self._shift.to(observation), self._scale.to(observation)
            observation = (observation - self._shift) * self._scale
        return next_tensordict.set(self.observation_key, observation)

    forward = _call

    def _lay_out(self, parts: Sequence[Tensor]) -> None:
        """Note which columns are whose, and shift and scale of each: one operation on all."""
        ends = torch.tensor([part.shape[-1] for part in parts]).cumsum(0).tolist()
        spans = zip([0, *ends], ends, strict=False)
        self.columns.update(zip(self.entries, (slice(a, b) for a, b in spans), strict=True))
        self._shift, self._scale = torch.zeros(ends[-1]), torch.ones(ends[-1])
        for entry, columns in zip(self.entries.values(), self.columns.values(), strict=True):
            self._shift[columns] = torch.tensor(entry.shift)
            self._scale[columns] = entry.scale

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        return self._call(tensordict_reset)

    def _see(self, tensordict: TensorDictBase) -> Seen:
        values = {}
        for name, key in self.keys.items():
            values[name] = tensordict.get(key, None)
            if values[name] is None:
                raise KeyError(
                    f"PushObservation: {key!r} is missing; there is "
                    f"{sorted(map(str, tensordict.keys(True, True)))}."
                )
        pose, ee_pose = values["object_pose"], values["ee_pose"]
        position = pose[..., :2]
        yaw = frame_yaw(self.frame, pose, values["subgoal"])
        past = values["subgoal_past"] - position.unsqueeze(-2)
        return Seen(
            ee_position=rotate(ee_pose[..., :2] - position, -yaw),
            ee_yaw=ee_pose[..., 2:] - yaw,
            object_yaw=pose[..., 2:] - yaw,
            goal=rotate(values["goal_position"] - position, -yaw),
            subgoal=rotate(values["subgoal"] - position, -yaw),
            subgoal_past=rotate(past, -yaw.unsqueeze(-2)),
            joint_position=values["joint_position"],
            path_length=values["path_length"],
            contact=values["object_contact"].float(),
            object_radius=values["object_radius"],
            latent=values.get("latent"),
            symmetry=self.symmetry,
            position=position,
            frame_yaw=yaw,
            bounds=(self._low.to(position), self._high.to(position)),
        )

    def transform_observation_spec(self, observation_spec: TensorSpec) -> TensorSpec:
        """Add the observation; its width is found by making one of zeros."""
        missing = [key for key in self.keys.values() if observation_spec.get(key, None) is None]
        if missing:
            raise KeyError(
                f"PushObservation: the environment does not emit {missing}; it emits "
                f"{sorted(map(str, observation_spec.keys(True, True)))}."
            )
        zeros = TensorDict(batch_size=observation_spec.shape, device=observation_spec.device)
        for key in self.keys.values():  # not the images
            zeros[key] = observation_spec[key].zero()
        width = self._call(zeros)[self.observation_key].shape[-1]
        observation_spec[self.observation_key] = Unbounded(
            shape=(*observation_spec.shape, width),
            dtype=torch.float32,
            device=observation_spec.device,
        )
        return observation_spec


def _look_up(entries: Sequence[str | tuple[str, Entry]]) -> dict[str, Entry]:
    if not entries:
        raise ValueError("PushObservation: entries is empty, expected at least one.")
    found: dict[str, Entry] = {}
    for item in entries:
        name, entry = item if isinstance(item, tuple) else (item, ENTRIES.get(item))
        if entry is None:
            raise ValueError(
                f"PushObservation: no entry {name!r}, expected one of {sorted(ENTRIES)}."
            )
        found[name] = entry
    return found
