"""`MirroredObservation`: what the agent would observe in the mirror image of its scene."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

from tensordict.utils import NestedKey

from modpush._arguments import checked_arguments
from modpush.geometry.frames import Frame
from modpush.mdp.entry_list import resolve_entries
from modpush.mdp.observation_entries import Entry, EntryLike
from modpush.mdp.observation_inputs import ObservationKeys
from modpush.mdp.push_observation import PushObservation

__all__ = ["MirroredObservation"]


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
                "with a `mirrored` function, or train without mirror images (mirror=False)."
            )
        mirrored[name] = replace(entry, read=entry.mirrored)
    return mirrored
