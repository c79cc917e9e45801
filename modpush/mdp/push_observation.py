"""`PushObservation`: chosen entries as one flat observation."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, replace
from functools import partial
from typing import Any

import torch
from tensordict import NestedKey, TensorDictBase
from torch import Tensor
from torchrl.data import TensorSpec

from modpush._checks import check_finite, read_key
from modpush._transforms import DescribedTransform, add_unbounded
from modpush._types import NonNegativeInteger
from modpush._validation import checked_arguments
from modpush.geometry.frames import Frame
from modpush.geometry.workspace import WORKSPACE, Rectangle
from modpush.mdp.entry_list import resolve_entries
from modpush.mdp.observation_entries import Entry, EntryLike
from modpush.mdp.observation_inputs import ObservationInputs, ObservationKeys
from modpush.mdp.observation_layout import Layout, ReadRecorder

_ACTION_DIM = 3


class PushObservation(DescribedTransform):
    """Writes one flat observation: chosen entries, in a frame at the object, scaled to order 1.

    Only the keys that the entries read are needed. Positions are in metres and angles in radians, in
    the robot's base frame. In a replay buffer, the observation is computed again at the root and,
    where there is one, in `"next"`; both must hold what the entries read.

    Args:
        frame: The agent's axes: `"object"` (the paper), `"path"` or `"base"`; the origin is the
            object's centre.
        entries: Names of `ENTRIES`, `"module:name"`, your own entries or functions, or pairs of a name
            and one of these, in order; see `resolve_entries`. By default `PATH_ENTRIES`
            in the path's frame, else `PAPER_ENTRIES`.
        bounds: Lower and upper corner of the area in which the object may be (`PushEnv.bounds`),
            base frame [m], for the entry `edges`; by default those of the default workspace.
        symmetry: Number of yaw angles at which every object is taken to look the same, 0 for all of
            them, instead of each object's own number. An agent that was trained with one object keeps
            that object's number with others, so that `object_axis` keeps its meaning.
        raw: Write SI units instead of shifted and scaled values.
        keys: Keys that the entries read.
        action_key: Read if an entry reads the last action, `[..., 3]`.
        observation_key: Written, `[..., n]` float32.

    Raises:
        ValueError: If the frame or an entry is unknown (the known ones are listed); if an entry has
            another shape than its scale or shift.
        KeyError: If a key that an entry reads is missing. In a call on a CPU, a ValueError if what an
            entry reads is not finite; on a GPU this check would stall the device.
    Source: table of observations in the paper's Sec. IV-B.
    """

    @checked_arguments
    def __init__(
        self,
        frame: Frame = "object",
        *,
        entries: Mapping[str, EntryLike]
        | Sequence[EntryLike | tuple[str, EntryLike]]
        | None = None,
        bounds: Rectangle | None = None,
        symmetry: NonNegativeInteger | None = None,
        raw: bool = False,
        keys: ObservationKeys | None = None,
        action_key: NestedKey = "action",
        observation_key: NestedKey = "observation",
    ) -> None:
        super().__init__(in_keys=[], out_keys=[observation_key])
        self.frame = frame
        self.entries = resolve_entries(frame, entries)
        self.bounds = WORKSPACE.bounds() if bounds is None else bounds
        self.symmetry, self.raw = symmetry, raw
        keys = keys or ObservationKeys()
        self._keys: dict[str, NestedKey] = asdict(keys)
        self.action_key, self.last_action_key = action_key, keys.last_action
        self.observation_key = observation_key
        low, high = (
            torch.tensor(corner, dtype=torch.float32, device="cpu") for corner in self.bounds
        )
        self._corners = low, high
        self._layout: Layout | None = None
        self._writes_last_action = False

    @property
    def columns(self) -> dict[str, slice]:
        """The columns of each entry in the observation, by name.

        Raises:
            RuntimeError: Before the environment's first reset or the first reading of its
                `observation_spec`, or before the transform was applied once.
        """
        if self._layout is None:
            raise RuntimeError(
                "PushObservation: the columns are known after the environment's first reset, once its "
                "observation_spec was read, or once the transform was applied to a tensordict."
            )
        return self._layout.columns

    def describe(self) -> dict[str, Any]:
        """Frame, and of each entry name, columns, shifts and scales.

        Before the environment's first reset or the first reading of its `observation_spec` only the
        entries' names are known.
        """
        named = [{"name": name} for name in self.entries]
        entries = named if self._layout is None else self._layout.describe()
        return {"observation": {"frame": self.frame, "raw": self.raw, "entries": entries}}

    def _call(self, next_tensordict: TensorDictBase) -> TensorDictBase:
        layout = self._layout if self._layout is not None else self._lay_out(next_tensordict)
        observation = self.read(next_tensordict)
        if observation.device.type == "cpu" and not math.isfinite(observation.detach().sum()):
            self._refuse_not_finite(next_tensordict)
        if not self.raw:
            observation = layout.normalise(observation)
        return next_tensordict.set(self.observation_key, observation)

    def _refuse_not_finite(self, tensordict: TensorDictBase) -> None:
        """Raise if something that is read is not finite; an entry's own result may be."""
        for key in self.in_keys:
            value = tensordict.get(key, None)
            if value is not None and value.is_floating_point():
                check_finite(repr(key), value)

    def read(self, source: Any) -> Tensor:
        """The entries before shift and scale, `[..., n]` float32, in SI units.

        Args:
            source: Tensordict or dictionary with `in_keys`.
        """
        return torch.cat(self._read_entries(source), -1).float()

    def _read_entries(self, tensordict: Any) -> list[Tensor]:
        inputs = ObservationInputs(tensordict, self.frame, self._keys, self._corners, self.symmetry)
        values = []
        for name, entry in self.entries.items():
            try:
                values.append(entry.read(inputs))
            except RuntimeError as error:
                raise RuntimeError(f"PushObservation: entry {name!r} failed: {error}") from error
        return values

    def _lay_out(self, source: TensorDictBase | TensorSpec) -> Layout:
        """Find the width of each entry, and the keys that are read, by reading them once."""
        zero_action = _no_action(source)
        recorder = ReadRecorder(source, {self.last_action_key: zero_action})
        self._layout = Layout(self.entries, self._read_entries(recorder), source.shape)
        self.in_keys = recorder.read
        self._writes_last_action = self.last_action_key in recorder.read
        written = [self.last_action_key] if self._writes_last_action else []
        self.out_keys = [self.observation_key, *written]
        return self._layout

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        if self._layout is None:
            self._lay_out(tensordict_reset)
        if self._writes_last_action:
            tensordict_reset.set(self.last_action_key, _no_action(tensordict_reset))
        return self._call(tensordict_reset)

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        if self._layout is None:
            self._lay_out(next_tensordict)
        if self._writes_last_action:
            action = read_key(tensordict, self.action_key)
            next_tensordict.set(self.last_action_key, action)
        return self._call(next_tensordict)

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Compute the observation of stored data again, at the root and in `"next"` if there is one."""
        following = tensordict.get("next", None)
        if following is not None:
            self._call(following)
        return self._call(tensordict)

    def transform_observation_spec(self, observation_spec: TensorSpec) -> TensorSpec:
        """Add the observation; its width is found by making one of zeros."""
        width = self._lay_out(observation_spec).width
        add_unbounded(observation_spec, self.observation_key, width)
        if self._writes_last_action:
            add_unbounded(observation_spec, self.last_action_key, _ACTION_DIM)
        return observation_spec


def _no_action(source: TensorDictBase | TensorSpec) -> Tensor:
    """Zeros `[..., 3]` for the batch and device of a tensordict or spec."""
    return torch.zeros(
        *source.shape, _ACTION_DIM, dtype=torch.float32, device=source.device or "cpu"
    )


class MirroredObservation(PushObservation):
    """Writes the observation of the scene mirrored at the x axis of the agent's frame.

    Put it beside a `PushObservation` with the same frame, entries and settings, for
    `modpush.replay.MirrorTransitions`. In the path's frame the axis is the line from the object to the
    sub-goal. The latent is that of the mirrored window, see `mirrored_key` of
    `modpush.encoders.Encode`.

    Args:
        frame: The agent's axes, as of `PushObservation`.
        entries: Entries as of `PushObservation`; each needs a `mirrored` function.
        keys: Keys that the entries read; by default the latent is read from `mirrored_latent`.
        observation_key: Written, `[..., n]` float32.
        **kwargs: Further arguments of `PushObservation`.

    Raises:
        ValueError: If an entry cannot be mirrored, as `joint_position`, and else as
            `PushObservation`.
    """

    @checked_arguments
    def __init__(
        self,
        frame: Frame = "object",
        *,
        entries: Mapping[str, EntryLike]
        | Sequence[EntryLike | tuple[str, EntryLike]]
        | None = None,
        keys: ObservationKeys | None = None,
        observation_key: NestedKey = "mirrored_observation",
        **kwargs: Any,
    ) -> None:
        super().__init__(
            frame,
            entries=_mirrored(resolve_entries(frame, entries)),
            keys=keys or ObservationKeys(latent="mirrored_latent"),
            observation_key=observation_key,
            **kwargs,
        )

    def describe(self) -> dict[str, Any]:
        """As of `PushObservation`, under a name of its own: it serves training alone."""
        return {"mirrored_observation": super().describe()["observation"]}


def _mirrored(entries: Mapping[str, Entry]) -> dict[str, Entry]:
    """Entries that read what the given ones would in the mirrored scene."""
    mirrored = {}
    for name, entry in entries.items():
        if entry.mirrored is None:
            raise ValueError(
                f"MirroredObservation: entry {name!r} cannot be mirrored: leave it out, give an Entry "
                "with `mirrored`, or train without mirror images (mirror=False)."
            )
        read = entry.mirrored
        if not callable(read):
            read = partial(_with_signs, entry.read, read)
        mirrored[name] = replace(entry, read=read)
    return mirrored


def _with_signs(
    read: Callable[[ObservationInputs], Tensor], signs: tuple[float, ...], inputs: ObservationInputs
) -> Tensor:
    value = read(inputs)
    return value * value.new_tensor(signs)
