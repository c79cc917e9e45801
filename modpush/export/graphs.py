"""The exported modules: an agent's greedy policy on tensors alone."""

from typing import Any

import torch
from tensordict.nn import TensorDictModule
from torch import Tensor, nn
from torchrl.modules import ProbabilisticActor, TanhNormal

from modpush._validation import checked_arguments
from modpush.geometry.frames import Frame, frame_yaw
from modpush.mdp.action_frame import turn_action
from modpush.mdp.push_observation import PushObservation

_LARGEST = 1.0 - torch.finfo(torch.float32).resolution  # what TorchRL's tanh is clamped to


class ObservationPolicy(nn.Module):
    """`observation [B, n] -> action [B, 3]`: the greedy action in [-1, 1] in the agent's frame.

    Args:
        policy: An agent's policy; its weights are shared, not copied.

    Raises:
        ValueError: If it reads more than the observation, or is not one network that gives location and
            scale to a Gaussian squashed by tanh into [-1, 1].
    """

    @checked_arguments
    def __init__(self, policy: ProbabilisticActor) -> None:
        super().__init__()
        if list(policy.in_keys) != ["observation"]:
            raise ValueError(
                "ObservationPolicy: the policy must read 'observation' alone, got "
                f"{list(policy.in_keys)}; an agent with an encoder of its own cannot be exported."
            )
        kind = policy[-1].distribution_class if isinstance(policy, ProbabilisticActor) else None
        if kind is not TanhNormal:
            raise ValueError(
                "ObservationPolicy: the policy must be a ProbabilisticActor with a TanhNormal, got "
                f"{type(policy).__name__} with {kind}."
            )
        network, *others = policy.module
        if len(others) != 1 or not _is_plain_call(network, others[0]):
            raise ValueError(
                "ObservationPolicy: the policy must be one network, called without names or a method, "
                f"and a distribution of what it gives, got {policy}."
            )
        _check_squashing(others[0])
        self.network = network.module

    def forward(self, observation: Tensor) -> Tensor:
        """The action of each observation."""
        loc, _ = self.network(observation)
        return loc.tanh().clamp(-_LARGEST, _LARGEST)


class WindowPolicy(nn.Module):
    """From the window and the state to the action, encoder and observation included.

    Inputs are `window [B, 1, S, S]` float32 in [0, 1], if there is an encoder, and the keys in
    `state_keys` as `make_push_env` emits them, in SI units and the base frame. Outputs are `action`
    `[B, 3]` in [-1, 1] in the agent's frame, and `command` `[B, 3]`, the same turned into the base
    frame, which `PushEnv` takes.

    Args:
        policy: `observation -> action`.
        observation: The agent's observation, laid out on an environment.
        encoder: `window -> latent`, or None.
        action_frame: Axes in which the agent acts.
    """

    shift: Tensor
    scale: Tensor

    def __init__(
        self,
        policy: ObservationPolicy,
        observation: PushObservation,
        encoder: nn.Module | None,
        action_frame: Frame,
    ) -> None:
        super().__init__()
        self.policy, self.encoder, self.action_frame = policy, encoder, action_frame
        entries = observation.describe()["observation"]["entries"]
        shift, scale = (
            torch.tensor([v for entry in entries for v in entry[name]], dtype=torch.float32)
            for name in ("shift", "scale")
        )
        self.register_buffer("shift", shift, persistent=False)
        self.register_buffer("scale", scale, persistent=False)
        self.raw = observation.raw
        self._read = observation.read  # not a submodule: its own state is not exported
        read = [key for key in observation.in_keys if key != "latent"]
        needed = {"object": ["object_pose"], "path": ["object_pose", "subgoal"]}
        self.state_keys = list(dict.fromkeys([*read, *needed.get(action_frame, [])]))
        """Keys of the inputs beside the window, in order."""

    @property
    def input_names(self) -> list[str]:
        """Names of all inputs, in order."""
        return [*(["window"] if self.encoder is not None else []), *self.state_keys]

    def forward(self, *inputs: Tensor) -> tuple[Tensor, Tensor]:
        """Action and command; the inputs are in the order of `input_names`."""
        state = dict(zip(self.input_names, inputs, strict=True))
        if self.encoder is not None:
            state["latent"] = self.encoder(state["window"])
        observation = self._read(state)
        if not self.raw:
            observation = (observation - self.shift) * self.scale
        action = self.policy(observation)
        if self.action_frame == "base":
            return action, action.clone()
        yaw = frame_yaw(self.action_frame, state["object_pose"], state.get("subgoal"))
        return action, turn_action(action, yaw)


def _check_squashing(head: Any) -> None:
    """Refuse distributions whose most likely action is another one than tanh of the first parameter."""
    options = dict(head.distribution_kwargs)
    bounds = [torch.as_tensor(options.pop(name, end)) for name, end in (("low", -1), ("high", 1))]
    usual = all(bool((bound == end).all()) for bound, end in zip(bounds, (-1, 1), strict=True))
    if options or not usual or head.dist_keys[0] != "loc":
        raise ValueError(
            "ObservationPolicy: the policy's TanhNormal must get loc first, lie between -1 and 1 and "
            f"have no other options, got {list(head.dist_keys)} and {dict(head.distribution_kwargs)}."
        )


def _is_plain_call(network: Any, head: Any) -> bool:
    """True for a network that takes its inputs in order and returns its head's parameters in order."""
    return (
        type(network) is TensorDictModule
        and network.method is None
        and network._kwargs is None  # a dictionary of in_keys names the arguments
        and list(network.out_keys_source) == list(head.in_keys)
        and all(isinstance(key, str) for key in head.dist_keys)
        and not any(part._forward_hooks or part._forward_pre_hooks for part in (network, head))
    )
