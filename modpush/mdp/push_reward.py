"""`PushReward`: a weighted sum of terms as the reward."""

from collections.abc import Mapping
from dataclasses import asdict, field
from typing import Any, Literal

import torch
from tensordict import NestedKey, TensorDictBase
from torchrl.data import TensorSpec

from modpush._checks import check_spec_has, read_key
from modpush._transforms import DescribedTransform, add_unbounded
from modpush._types import Finite, Length, Name, Positive
from modpush._validation import checked, checked_arguments
from modpush.mdp.reward_terms import REWARD_TERMS, RewardTerm
from modpush.mdp.step_outcome import RewardKeys, StepOutcome, measure_lengths
from modpush.parts import find_part

_READ_BY_SOME_TERMS = ("action", "pose_error", "object_radius", "pose_path_length")
"""Names of keys that need not be there."""


def _paper_weights() -> dict[str, float]:
    return {
        "goal": 50.0,
        "distance": 1.0,
        "approach": 1.0,
        "touch": 1.0,
        "object_collision": 5.0,
        "out_of_bounds": 10.0,
    }


@checked
class RewardConfig:
    """Reward of a step: a weighted sum of terms; the defaults are the paper's (Sec. IV-B, eq. 2 to 5).

    The paper's collision part (eq. 3) gives a step either -10 or -5; here a step to which both apply
    gets their sum.
    """

    weights: Mapping[Name, Finite] = field(default_factory=_paper_weights)
    """Weight of each term, by its name in `REWARD_TERMS`, or as "module:name" for your own term. A
    term without a weight, or with weight 0, is not computed."""
    scale: Positive = 1.0
    """Factor of the weighted sum. The entropy temperature (`TQCConfig.alpha_init`) has to match it."""
    normalisation: Literal["initial", "constant"] = "initial"
    """Divide the path length and the tool's distance from the object by their values at reset
    ("initial", the paper), or by `path_length` and `approach_distance` ("constant")."""
    clip: bool = True
    """Clip both normalised distances at 1. The paper scales them "between 0 and 1" without saying how;
    its authors' code divides by the values at reset and does not clip. With the clip, the reward no
    longer changes once object or tool are further away than at reset."""
    path_length: Length = 0.6
    """Path length that counts as 1 with the normalisation "constant" [m]."""
    approach_distance: Length = 0.15
    """Distance from tool to object that counts as 1 with the normalisation "constant" [m]."""
    window_radius: Length = 0.114
    """Distance from the object beyond which the tool is outside the window: half the side of one of 64
    pixels of 3.56 mm [m]. Set it for an encoder of other windows."""


class PushReward(DescribedTransform):
    """Replaces the reward by a weighted sum of terms, and writes each of them for the log.

    Path length and approach distance at reset are stored in the tensordict, so that partial resets,
    copies and workers are right by construction. A reward belongs to the step that led to it: it is
    written in `"next"`, from what `"next"` holds after the step, the root before it, and the
    action at the root.

    Args:
        config: Weights, scale and normalisation.
        terms: Your own terms by name, as functions or as `"module:name"`, in addition to those of
            `REWARD_TERMS` or in place of them; each needs a weight in the config.
        keys: Keys that the terms read.
        reward_key: Written, `[..., 1]` float32.
        terms_key: Written, a nested tensordict with each term, weighted and scaled, `[..., 1]`.
        start_key: Written at reset, handed on at each step and read back, `[..., 2]` float32: path
            length and distance from tip to object at reset [m].

    Raises:
        ValueError: If a weight has no term, or one of your terms has no weight.
        KeyError: If a key that is read is missing.
    Source: Sec. IV-B, eq. 2 to 5.
    """

    @checked_arguments
    def __init__(
        self,
        config: RewardConfig | None = None,
        *,
        terms: Mapping[str, RewardTerm | str] | None = None,
        keys: RewardKeys | None = None,
        reward_key: NestedKey = "reward",
        terms_key: NestedKey = "reward_terms",
        start_key: NestedKey = "reward_start",
    ) -> None:
        self.config = config or RewardConfig()
        self.terms, self._weights = _find_terms(self.config, terms or {})
        self._keys: dict[str, NestedKey] = asdict(keys or RewardKeys())
        self.reward_key, self.terms_key, self.start_key = reward_key, terms_key, start_key
        group = (terms_key,) if isinstance(terms_key, str) else terms_key
        self._term_keys = {name: (*group, name) for name in self.terms}
        super().__init__(
            in_keys=[key for name, key in self._keys.items() if name not in _READ_BY_SOME_TERMS],
            out_keys=[reward_key, start_key, *self._term_keys.values()],
        )

    def describe(self) -> dict[str, Any]:
        """The config, and the terms that are computed."""
        return {"reward": {**asdict(self.config), "terms": sorted(self.terms)}}

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        # TorchRL puts back the old values of scenes that are not being reset.
        start = measure_lengths(tensordict_reset, self._keys)
        tensordict_reset.set(self.start_key, start)
        for key in self._term_keys.values():
            tensordict_reset.set(key, torch.zeros_like(start[..., :1]))
        return tensordict_reset

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        config = self.config
        start = unit = read_key(tensordict, self.start_key, 2)
        if config.normalisation == "constant":
            unit = start.new_tensor([config.path_length, config.approach_distance])
        outcome = StepOutcome(
            tensordict, next_tensordict, self._keys, unit, config.window_radius, clip=config.clip
        )
        total = torch.zeros_like(start[..., :1], dtype=torch.float32)
        for name, term in self.terms.items():
            value = term(outcome).float() * (self._weights[name] * config.scale)
            if value.shape != total.shape:
                raise ValueError(
                    f"PushReward: term {name!r} must be {list(total.shape)}, got {list(value.shape)}."
                )
            next_tensordict.set(self._term_keys[name], value)
            total = total + value
        next_tensordict.set(self.start_key, start)
        return next_tensordict.set(self.reward_key, total)

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Reward stored transitions again, in `"next"`; rewards at the root, of earlier steps, stay.

        Raises:
            KeyError: If `"next"` or the lengths at reset are not stored with the transitions.
        """
        self._step(tensordict, read_key(tensordict, "next"))
        return tensordict

    def transform_reward_spec(self, reward_spec: TensorSpec) -> TensorSpec:
        """Put the sum, which is unbounded, in place of the reward."""
        add_unbounded(reward_spec, self.reward_key, 1)
        return reward_spec

    def transform_observation_spec(self, observation_spec: TensorSpec) -> TensorSpec:
        """Add the terms and the lengths at reset."""
        check_spec_has(observation_spec, self.in_keys)
        for key in self._term_keys.values():
            add_unbounded(observation_spec, key, 1)
        add_unbounded(observation_spec, self.start_key, 2)
        return observation_spec


def _find_terms(
    config: RewardConfig, own: Mapping[str, RewardTerm | str]
) -> tuple[dict[str, RewardTerm], dict[str, float]]:
    """Terms and weights by name, of those with a weight that is not 0, in the weights' order."""
    if idle := sorted(set(own) - set(config.weights)):
        raise ValueError(
            f"PushReward: terms must have a weight in the config, which has weights for "
            f"{sorted(config.weights)}, got {idle}."
        )
    known = {**REWARD_TERMS, **own}
    terms: dict[str, RewardTerm] = {}
    weights: dict[str, float] = {}
    for text, weight in config.weights.items():
        term = known[text] if text in known else find_part("weights", text, known)
        if isinstance(term, str):
            term = find_part("terms", term, REWARD_TERMS)
        if not callable(term):
            raise TypeError(f"PushReward: term {text!r} must be a function, got {term!r}.")
        name = text.rpartition(":")[2].rpartition(".")[2]
        if name in weights:
            raise ValueError(f"PushReward: weights has the term {name!r} twice.")
        weights[name] = weight
        if weight:
            terms[name] = term
    return terms, weights
