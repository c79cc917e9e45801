"""The paper's reward, term by term, and the transform that adds the terms up."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Literal, NamedTuple

import torch
from tensordict import NestedKey, TensorDictBase
from torch import Tensor
from torchrl.data import TensorSpec, Unbounded
from torchrl.envs import Transform

__all__ = ["REWARD_TERMS", "Happened", "PushReward", "RewardConfig", "RewardTerm"]


class Happened(NamedTuple):
    """What a step led to, `[..., 1]` each."""

    path: Tensor
    """Length of the planned path, as a share of where it began, in [0, 1]."""
    approach: Tensor
    """Distance from the tool's tip to the object's centre, likewise."""
    success: Tensor
    object_contact: Tensor
    obstacle_contact: Tensor
    tool_obstacle_contact: Tensor
    out_of_bounds: Tensor
    outside_window: Tensor
    """The tip is farther from the object than the window's edge."""


RewardTerm = Callable[[Happened], Tensor]
"""`Happened -> [..., 1]`, before its weight."""


def goal(happened: Happened) -> Tensor:
    """1 on reaching the goal. Source: Sec. IV-B, eq. 3."""
    return happened.success.float()


def distance(happened: Happened) -> Tensor:
    """The way still to go, in [-1, 0]; nothing on reaching the goal. Source: eq. 3."""
    return -happened.path * ~happened.success


def approach(happened: Happened) -> Tensor:
    """How far the tool is from the object, in [-1, 0]; nothing on reaching the goal. Source: eq. 3."""
    return -happened.approach * ~happened.success


def touch(happened: Happened) -> Tensor:
    """Takes the approach's penalty back while tool and object touch. Source: eq. 5."""
    return happened.approach * happened.object_contact


def object_collision(happened: Happened) -> Tensor:
    """-1 where the object touches an obstacle. Source: eq. 4."""
    return -happened.obstacle_contact.float()


def tool_collision(happened: Happened) -> Tensor:
    """-1 where the tool or the arm touches one. Source: the authors' code."""
    return -happened.tool_obstacle_contact.float()


def out_of_bounds(happened: Happened) -> Tensor:
    """-1 where the object leaves the workspace. Source: eq. 4."""
    return -happened.out_of_bounds.float()


def window(happened: Happened) -> Tensor:
    """-1 where the tool is outside the local window. Source: the authors' code."""
    return -happened.outside_window.float()


REWARD_TERMS: dict[str, RewardTerm] = {
    term.__name__: term
    for term in (
        *(goal, distance, approach, touch),
        *(object_collision, tool_collision, out_of_bounds, window),
    )
}
"""By name; `RewardConfig.weights` says what each counts."""


def _paper_weights() -> dict[str, float]:
    return {
        **{"goal": 50.0, "distance": 1.0, "approach": 1.0, "touch": 1.0},
        **{"object_collision": 5.0, "tool_collision": 2.0, "out_of_bounds": 10.0, "window": 0.0},
    }


@dataclass(frozen=True, kw_only=True)
class RewardConfig:
    """What a step is worth; the defaults are the paper's (Sec. IV-B, eq. 2-5), scaled."""

    weights: Mapping[str, float] = field(default_factory=_paper_weights)
    """Of each term."""
    scale: float = 0.1
    """Of the sum; 1 gives the paper's numbers."""
    normalisation: Literal["initial", "constant"] = "initial"
    """Divide path and approach by their values at reset (the paper), or by the two lengths below."""
    path_length: float = 0.6
    """For `"constant"` [m]."""
    approach_distance: float = 0.15
    """For `"constant"` [m]."""
    window_radius: float = 0.114
    """Half the local window's side [m]."""

    def __post_init__(self) -> None:
        """Check the ranges."""
        if self.normalisation not in ("initial", "constant"):
            raise ValueError(
                "RewardConfig: normalisation must be 'initial' or 'constant', "
                f"got {self.normalisation!r}."
            )
        for name in ("scale", "path_length", "approach_distance", "window_radius"):
            if not getattr(self, name) > 0:
                raise ValueError(f"RewardConfig: {name} must be > 0, got {getattr(self, name)}.")


class PushReward(Transform):
    """Replaces the reward by a weighted sum of terms, and writes each of them for the log.

    Where path and approach began stands in the tensordict, so that partial resets, copies and
    workers are right by construction.

    Args:
        config: Weights, scale and normalisation.
        terms: Terms of yours, by name, beside or instead of `REWARD_TERMS`.
        keys: Other names for the keys read, by their default names: `path_length`, `success`,
            `object_contact`, `obstacle_contact`, `tool_obstacle_contact`, `out_of_bounds`
            `[..., 1]`, `object_pose`, `ee_pose` `[..., 3]`.
        reward_key: Written, `[..., 1]` float32.
        terms_key: Written, a nested tensordict with each term, weighted and scaled, `[..., 1]`.
        start_key: Written and read back, `[..., 2]` float32: path length and distance from tip to
            object at reset [m].

    Raises:
        ValueError: If a weight has no term or a key is unknown.
        KeyError: If a key is missing.
    Source: Sec. IV-B, eq. 2-5; spec 6.
    """

    READ = (
        *("path_length", "object_pose", "ee_pose", "object_contact", "obstacle_contact"),
        *("tool_obstacle_contact", "success", "out_of_bounds"),
    )

    def __init__(
        self,
        config: RewardConfig | None = None,
        *,
        terms: Mapping[str, RewardTerm] | None = None,
        keys: Mapping[str, NestedKey] | None = None,
        reward_key: NestedKey = "reward",
        terms_key: str = "reward_terms",
        start_key: NestedKey = "reward_start",
    ) -> None:
        self.config = config or RewardConfig()
        known = {**REWARD_TERMS, **(terms or {})}
        if unknown := sorted(set(self.config.weights) - set(known)):
            raise ValueError(f"PushReward: no terms {unknown}, expected some of {sorted(known)}.")
        if unknown := sorted(set(keys or {}) - set(self.READ)):
            raise ValueError(f"PushReward: keys has no {unknown}, expected some of {self.READ}.")
        self.terms = {name: known[name] for name, weight in self.config.weights.items() if weight}
        self.keys: dict[str, NestedKey] = {name: (keys or {}).get(name, name) for name in self.READ}
        self.reward_key, self.terms_key, self.start_key = reward_key, terms_key, start_key
        super().__init__(
            in_keys=list(self.keys.values()),
            out_keys=[reward_key, start_key, *((terms_key, name) for name in self.terms)],
        )

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        # TorchRL puts back the old values of scenes that are not being reset.
        tensordict_reset.set(self.start_key, self._measure(tensordict_reset))
        nothing = torch.zeros_like(self._read(tensordict_reset, "path_length"))
        for name in self.terms:
            tensordict_reset.set((self.terms_key, name), nothing.clone())
        return tensordict_reset

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        return self._write(next_tensordict, tensordict.get(self.start_key))

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Reward stored data anew; what a step led to is read under `"next"` where there is one."""
        after = tensordict.get("next", None)
        after = tensordict if after is None else after
        start = tensordict.get(self.start_key, None)
        if start is None:
            raise KeyError(f"PushReward: {self.start_key!r} is missing; store it with the data.")
        self._write(after, start)
        return tensordict

    def _read(self, tensordict: TensorDictBase, name: str) -> Tensor:
        value = tensordict.get(self.keys[name], None)
        if value is None:
            raise KeyError(
                f"PushReward: {self.keys[name]!r} is missing; there is "
                f"{sorted(map(str, tensordict.keys(True, True)))}."
            )
        return value

    def _measure(self, tensordict: TensorDictBase) -> Tensor:
        """Path length and distance from tip to object, `[..., 2]` [m]."""
        tip, centre = self._read(tensordict, "ee_pose"), self._read(tensordict, "object_pose")
        apart = (tip[..., :2] - centre[..., :2]).norm(dim=-1, keepdim=True)
        return torch.cat([self._read(tensordict, "path_length"), apart], -1)

    def _write(self, after: TensorDictBase, start: Tensor) -> TensorDictBase:
        config, measured = self.config, self._measure(after)
        unit = start
        if config.normalisation == "constant":
            unit = start.new_tensor([config.path_length, config.approach_distance])
        share = (measured / unit.clamp_min(1e-6)).clamp(0.0, 1.0)
        happened = Happened(
            path=share[..., :1],
            approach=share[..., 1:],
            outside_window=measured[..., 1:] > config.window_radius,
            **{name: self._read(after, name) for name in Happened._fields if name in self.keys},
        )
        total = torch.zeros_like(happened.path)
        for name, term in self.terms.items():
            value = term(happened) * (config.weights[name] * config.scale)
            after.set((self.terms_key, name), value)
            total = total + value
        after.set(self.start_key, start)
        return after.set(self.reward_key, total)

    def transform_reward_spec(self, reward_spec: TensorSpec) -> TensorSpec:
        """The sum is unbounded."""
        shape, device = reward_spec[self.reward_key].shape, reward_spec.device
        reward_spec[self.reward_key] = Unbounded(shape=shape, dtype=torch.float32, device=device)
        return reward_spec

    def transform_observation_spec(self, observation_spec: TensorSpec) -> TensorSpec:
        """Add the terms and the state."""
        lead, device = observation_spec.shape, observation_spec.device
        for name in self.terms:
            observation_spec[self.terms_key, name] = Unbounded(
                shape=(*lead, 1), dtype=torch.float32, device=device
            )
        observation_spec[self.start_key] = Unbounded(
            shape=(*lead, 2), dtype=torch.float32, device=device
        )
        return observation_spec
