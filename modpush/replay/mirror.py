"""`MirrorTransitions`: a random half of each batch as their mirror images."""

from collections.abc import Sequence
from typing import Any

import torch
from tensordict import TensorDictBase
from tensordict.utils import NestedKey, unravel_key

from modpush._checks import read_key
from modpush._transforms import DescribedTransform
from modpush._types import Finite, Fraction
from modpush._validation import checked_arguments


class MirrorTransitions(DescribedTransform):
    """Replaces some of the transitions sampled from a replay buffer by mirrored ones.

    A scene that is mirrored at the x axis of the agent's frame behaves like the scene itself, so that
    each transition is worth two. Append the transform to a replay buffer with `append_transform`. The
    choice is drawn again in every sample, from torch's generator of random numbers. The samples do not
    contain the mirrored observations.

    Args:
        action_signs: Factors of the components of a mirrored action (dx, dy, dyaw).
        fraction: Probability with which a transition is mirrored.
        action_key: Read and written, `[B, A]`.
        observation_key: Read and written, `[B, n]`, at the root and under `"next"`.
        mirrored_key: Read and removed, `[B, n]`, at the root and under `"next"`: the observation in the
            mirrored scene, see `modpush.mdp.MirroredObservation`.

    Raises:
        KeyError: In a call, if a key is missing; the known ones are listed.
    """

    @checked_arguments
    def __init__(
        self,
        *,
        action_signs: Sequence[Finite] = (1.0, -1.0, -1.0),
        fraction: Fraction = 0.5,
        action_key: NestedKey = "action",
        observation_key: NestedKey = "observation",
        mirrored_key: NestedKey = "mirrored_observation",
    ) -> None:
        super().__init__()
        self.fraction, self.action_key = fraction, action_key
        self.observation_key, self.mirrored_key = observation_key, mirrored_key
        self.register_buffer("signs", torch.tensor(action_signs, dtype=torch.float32))

    def describe(self) -> dict[str, Any]:
        """Share of the transitions that are mirrored."""
        return {"mirror": {"fraction": self.fraction}}

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Mirror transitions `[B]`; the tensordict itself stays as it is."""
        batch = tensordict.copy()
        action = read_key(batch, self.action_key)
        chosen = torch.rand(*batch.shape, 1, device="cpu") < self.fraction  # alike on all devices
        chosen = chosen.to(action.device)
        for place in ((), ("next",)):
            observation_key = unravel_key((*place, self.observation_key))
            mirrored_key = unravel_key((*place, self.mirrored_key))
            observation = read_key(batch, observation_key)
            mirrored = read_key(batch, mirrored_key)
            batch.set(observation_key, torch.where(chosen, mirrored, observation))
            batch = batch.exclude(mirrored_key)
        signs = self.signs.to(action)
        if action.shape[-1:] != signs.shape:
            raise ValueError(
                f"MirrorTransitions: {self.action_key!r} must have {len(signs)} components, as many as "
                f"action_signs, got {list(action.shape)}."
            )
        return batch.set(self.action_key, torch.where(chosen, action * signs, action))
