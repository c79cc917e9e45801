"""A TQC agent in one call: networks, loss, target updater and optimizer from one config."""

from dataclasses import dataclass, replace
from typing import Any, Literal

import torch
from tensordict.nn import TensorDictSequential
from tensordict.utils import NestedKey
from torch import nn
from torchrl.data import Bounded, Composite
from torchrl.envs import EnvBase
from torchrl.modules import AdditiveGaussianModule, ProbabilisticActor, ValueOperator
from torchrl.objectives import SoftUpdate

from modpush.agents.tqc.loss import TQCLoss
from modpush.agents.tqc.networks import make_actor, make_critic
from modpush.agents.tqc.update import Execution, TQCUpdate

__all__ = ["TQCAgent", "TQCConfig", "make_tqc", "make_tqc_from_specs"]

Preset = Literal["paper", "cpu", "gpu"]


@dataclass(frozen=True, kw_only=True)
class TQCConfig:
    """Everything that defines a TQC agent; the defaults are the paper's."""

    hidden_sizes: tuple[int, ...] = (512, 256, 128)
    """Widths of the hidden layers of actor and critics."""
    num_critics: int = 2
    """Critics in the ensemble."""
    num_quantiles: int = 25
    """Atoms a critic."""
    top_quantiles_to_drop_per_net: int = 2
    """Highest atoms dropped from the pooled target, a critic."""
    layer_norm: bool = False
    """Layer norm in the critics' hidden layers."""
    gamma: float = 0.98
    """Discount a step."""
    tau: float = 0.005
    """Step of the target critics towards the critics, an update."""
    actor_lr: float = 1e-4
    """Adam's learning rate of the actor."""
    critic_lr: float = 1e-4
    """Adam's learning rate of the critics."""
    alpha_lr: float = 1e-4
    """Adam's learning rate of the log-temperature."""
    alpha_init: float = 1.0
    """Entropy temperature at the start."""
    min_alpha: float | None = None
    """Lower bound of the temperature."""
    max_alpha: float | None = None
    """Upper bound of the temperature."""
    fixed_alpha: bool = False
    """Keep the temperature where it starts."""
    target_entropy: float | Literal["auto"] = "auto"
    """Entropy that the temperature aims at [nat]; `"auto"` is minus the action's width."""
    skip_done_states: bool = False
    """Do not evaluate next states of terminal transitions (they may be NaN)."""
    exploration_sigma: float = 0.4
    """Standard deviation of the noise added to actions, in halves of the action's range."""
    batch_size: int = 512
    """Transitions an update."""
    learning_starts: int = 10_000
    """Random environment steps before the first update."""
    updates_per_step: float = 1.0
    """Updates per environment step."""
    device: str = "cpu"
    """Where networks and updates live."""
    execution: Execution = "eager"
    """How an update runs: op by op, compiled, or as one CUDA graph."""

    def __post_init__(self) -> None:
        """Check the ranges."""
        for name in (
            *("num_critics", "num_quantiles", "batch_size", "tau", "actor_lr", "critic_lr"),
            *("alpha_lr", "alpha_init", "updates_per_step"),
        ):
            if not getattr(self, name) > 0:
                raise ValueError(f"TQCConfig: {name} must be > 0, got {getattr(self, name)}.")
        for name in ("exploration_sigma", "learning_starts", "top_quantiles_to_drop_per_net"):
            if not getattr(self, name) >= 0:
                raise ValueError(f"TQCConfig: {name} must be >= 0, got {getattr(self, name)}.")
        if not self.hidden_sizes or min(self.hidden_sizes) < 1:
            raise ValueError(
                f"TQCConfig: hidden_sizes must hold widths >= 1, got {self.hidden_sizes}."
            )
        if not 0 <= self.gamma <= 1:
            raise ValueError(f"TQCConfig: gamma must be in [0, 1], got {self.gamma}.")
        if self.tau > 1:
            raise ValueError(f"TQCConfig: tau must be in (0, 1], got {self.tau}.")
        if self.top_quantiles_to_drop_per_net >= self.num_quantiles:
            raise ValueError(
                "TQCConfig: top_quantiles_to_drop_per_net must be < num_quantiles "
                f"({self.num_quantiles}), got {self.top_quantiles_to_drop_per_net}."
            )
        low, high = self.min_alpha or 0.0, self.max_alpha or float("inf")
        if not 0 <= low <= self.alpha_init <= high:
            raise ValueError(
                "TQCConfig: alpha_init must lie between min_alpha and max_alpha, got "
                f"{self.min_alpha} <= {self.alpha_init} <= {self.max_alpha}."
            )

    @classmethod
    def preset(cls, name: Preset, **overrides: Any) -> "TQCConfig":
        """A named set of values, with single fields overridden.

        Args:
            name: `"paper"` is the paper's setting. `"cpu"` is what learned best in minutes on two
                cores: small networks, few updates a step, a temperature that fits rewards of
                order 1. `"gpu"` is the paper's networks with that temperature in CUDA graphs.
            **overrides: Fields to set differently.

        Raises:
            ValueError: If there is no such preset.
        """
        if name not in _PRESETS:
            raise ValueError(f"TQCConfig: preset must be one of {sorted(_PRESETS)}, got {name!r}.")
        return replace(cls(**_PRESETS[name]), **overrides)


_LEARNING_RATE = {"actor_lr": 3e-4, "critic_lr": 3e-4, "alpha_lr": 3e-4}
_PRESETS: dict[str, dict[str, Any]] = {
    "paper": {},
    "cpu": {
        **_LEARNING_RATE,
        "hidden_sizes": (256, 256),
        "batch_size": 256,
        "alpha_init": 0.02,
        "learning_starts": 3000,
        "updates_per_step": 0.125,
    },
    "gpu": {
        **_LEARNING_RATE,
        "alpha_init": 0.02,
        "updates_per_step": 0.125,
        "device": "cuda",
        "execution": "cudagraph",
    },
}


@dataclass(frozen=True, kw_only=True)
class TQCAgent:
    """The parts of a TQC agent; take them apart as you like."""

    config: TQCConfig
    """What it was made from."""
    actor: ProbabilisticActor
    """The policy, for evaluation and deployment."""
    exploration_policy: TensorDictSequential
    """The policy with noise added to its actions, for collection."""
    critics: list[ValueOperator]
    """The critics as modules. The loss trains its own copies, stacked; see `TQCLoss`."""
    loss: TQCLoss
    """The loss with its value estimator set."""
    target_updater: SoftUpdate
    """Moves the target critics."""
    optimizer: torch.optim.Adam
    """One fused Adam whose parameter groups `actor`, `critic` and `alpha` are as independent as
    three optimizers, and cheaper."""
    update: TQCUpdate
    """One optimisation step on a batch, as `config.execution` says."""


def make_tqc(
    config: TQCConfig,
    env: EnvBase,
    *,
    observation_key: NestedKey = "observation",
    action_key: NestedKey | None = None,
) -> TQCAgent:
    """Build a TQC agent for an environment.

    Args:
        config: The agent's settings.
        env: An environment, batched or not, with a flat observation and one bounded action.
        observation_key: The observation's key in `env.observation_spec`.
        action_key: The action's key; by default the environment's own.

    Returns:
        The agent's parts.

    Raises:
        ValueError: If the observation is missing or not flat, or the action is not bounded.
    """
    action_key = env.action_key if action_key is None else action_key
    return make_tqc_from_specs(
        config,
        env.full_observation_spec_unbatched,
        env.full_action_spec_unbatched[action_key],
        observation_key=observation_key,
        action_key=action_key,
    )


def make_tqc_from_specs(
    config: TQCConfig,
    observation_spec: Composite,
    action_spec: Bounded,
    *,
    observation_key: NestedKey = "observation",
    action_key: NestedKey = "action",
) -> TQCAgent:
    """The same where the environment is elsewhere, say in another process.

    Args:
        config: The agent's settings.
        observation_spec: The environment's `full_observation_spec_unbatched`.
        action_spec: Spec of one action, `[A]`.
        observation_key: The observation's key in its spec.
        action_key: The action's key in the data.

    Returns:
        The agent's parts.

    Raises:
        ValueError: As `make_tqc`.
    """
    action_spec = action_spec.to(config.device)
    observation_dim = _observation_dim(observation_spec, observation_key)
    actor = make_actor(
        observation_dim,
        action_spec,
        config.hidden_sizes,
        observation_key=observation_key,
        action_key=action_key,
        device=config.device,
    )
    critics = [
        make_critic(
            observation_dim,
            action_spec.shape[-1],
            config.num_quantiles,
            config.hidden_sizes,
            layer_norm=config.layer_norm,
            observation_key=observation_key,
            action_key=action_key,
            device=config.device,
        )
        for _ in range(config.num_critics)
    ]
    loss = _make_loss(config, actor, critics, action_spec, action_key)
    target_updater = SoftUpdate(loss, tau=config.tau)
    optimizer = _make_optimizer(config, loss)
    noise = _make_noise(config, action_spec, action_key)
    return TQCAgent(
        config=config,
        actor=actor,
        exploration_policy=TensorDictSequential(actor, noise),
        critics=critics,
        loss=loss,
        target_updater=target_updater,
        optimizer=optimizer,
        update=TQCUpdate(loss, optimizer, target_updater, execution=config.execution),
    )


def _observation_dim(specs: Composite, key: NestedKey) -> int:
    spec = specs.get(key, None)
    if spec is None:
        keys = list(specs.keys(True, True))
        raise ValueError(f"make_tqc: observation_key {key!r} not found, the env has {keys}.")
    if len(spec.shape) != 1:
        raise ValueError(
            f"make_tqc: {key!r} must be a flat observation [D], got shape {tuple(spec.shape)}; "
            "flatten it with torchrl's FlattenObservation or CatTensors."
        )
    return spec.shape[0]


def _make_loss(
    config: TQCConfig,
    actor: ProbabilisticActor,
    critics: list[ValueOperator],
    action_spec: Bounded,
    action_key: NestedKey,
) -> TQCLoss:
    loss = TQCLoss(
        actor,
        critics,
        num_qvalue_nets=config.num_critics,
        top_quantiles_to_drop_per_net=config.top_quantiles_to_drop_per_net,
        alpha_init=config.alpha_init,
        min_alpha=config.min_alpha,
        max_alpha=config.max_alpha,
        fixed_alpha=config.fixed_alpha,
        action_spec=action_spec,
        # The action's width is known here; TorchRL would look it up through the key.
        target_entropy=(
            -float(action_spec.shape[-1])
            if config.target_entropy == "auto"
            else config.target_entropy
        ),
        skip_done_states=config.skip_done_states,
    )
    loss.set_keys(action=action_key)
    loss.make_value_estimator(gamma=config.gamma)
    return loss.to(config.device)


def _make_optimizer(config: TQCConfig, loss: nn.Module) -> torch.optim.Adam:
    groups: dict[str, list[nn.Parameter]] = {"actor": [], "critic": [], "alpha": []}
    for name, parameter in loss.named_parameters():
        if parameter.requires_grad:
            prefix = name.split("_")[0]  # actor_network_params, qvalue_network_params, log_alpha
            groups[{"actor": "actor", "qvalue": "critic", "log": "alpha"}[prefix]].append(parameter)
    rates = {"actor": config.actor_lr, "critic": config.critic_lr, "alpha": config.alpha_lr}
    return torch.optim.Adam(
        [
            {"params": parameters, "lr": rates[name], "name": name}
            for name, parameters in groups.items()
            if parameters
        ],
        fused=True,
        capturable=config.device.startswith("cuda"),
    )


def _make_noise(
    config: TQCConfig, action_spec: Bounded, action_key: NestedKey
) -> AdditiveGaussianModule:
    noise = AdditiveGaussianModule(
        action_spec,
        sigma_init=float(config.exploration_sigma),
        sigma_end=float(config.exploration_sigma),
        action_key=action_key,
        device=torch.device(config.device),
    )
    noise.std = (action_spec.space.high - action_spec.space.low) / 2  # of each action component
    return noise
