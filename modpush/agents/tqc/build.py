"""A TQC agent in one call: networks, loss, target updater and optimizer from one config."""

import pickle
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import torch
from tensordict.nn import TensorDictModule, TensorDictSequential
from tensordict.utils import NestedKey
from torch import nn
from torchrl.data import Bounded, Composite
from torchrl.envs import EnvBase
from torchrl.modules import AdditiveGaussianModule, ProbabilisticActor
from torchrl.objectives import LossModule, SoftUpdate

from modpush._extras import warn_experimental
from modpush._precision import processor_precision
from modpush._validation import checked_arguments
from modpush.agents.tqc.config import TQCConfig
from modpush.agents.tqc.encoder import make_trained_encoder
from modpush.agents.tqc.factories import (
    ACTORS,
    CRITICS,
    LOSSES,
    ActorFactory,
    CriticFactory,
    LearnerSpecs,
    LossFactory,
)
from modpush.agents.tqc.update import TQCUpdate
from modpush.parts import find_part

Encoder = str | nn.Module | Callable[[], nn.Module]


@dataclass(frozen=True, kw_only=True)
class TQCAgent:
    """The parts of an agent, each of which can be used alone."""

    config: TQCConfig
    """The config that it was built from."""
    actor: ProbabilisticActor
    """The policy, for evaluation and deployment."""
    exploration_policy: TensorDictSequential
    """The policy with noise added to its actions, for collection."""
    critics: list[TensorDictModule]
    """The critics as modules. The loss trains its own copies, stacked; see `TQCLoss`."""
    loss: LossModule
    """The loss with its value estimator set."""
    target_updater: SoftUpdate | None
    """Moves the target networks; None for a loss that has none."""
    optimizer: torch.optim.Adam
    """One fused Adam whose parameter groups `actor`, `critic` and `alpha` are as independent as
    three optimizers, and cheaper."""
    update: TQCUpdate
    """One optimisation step on a batch, run as `config.execution` says."""

    def __deepcopy__(self, memo: dict[int, Any]) -> "TQCAgent":
        # Part by part, the parameters that loss, actor and optimizer share would be copied for each.
        try:
            return pickle.loads(pickle.dumps(self))
        except (AttributeError, TypeError, pickle.PicklingError) as error:
            raise TypeError(
                f"TQCAgent: an agent with {type(self.loss).__name__} cannot be copied, since that cannot "
                f"be pickled ({error}); make another one and load the loss's state_dict."
            ) from error


@checked_arguments
def make_tqc(
    config: TQCConfig,
    env: EnvBase,
    *,
    observation_key: NestedKey = "observation",
    action_key: NestedKey | None = None,
    loss: str | LossFactory | None = None,
    actor: str | ActorFactory | None = None,
    critic: str | CriticFactory | None = None,
    encoder: Encoder | None = None,
) -> TQCAgent:
    """Build an agent for an environment.

    Args:
        config: The agent's settings.
        env: An environment, batched or not, with a flat observation and one bounded action.
        observation_key: The observation's key in `env.observation_spec`.
        action_key: The action's key; by default the environment's own.
        loss: A name, "module:name" or `LossFactory`, in place of `config.loss`.
        actor: A name, "module:name" or `ActorFactory`, in place of `config.actor`.
        critic: A name, "module:name" or `CriticFactory`, in place of `config.critic`.
        encoder: "module:name", a module, or what makes one, in place of `config.encoder`.

    Returns:
        The agent's parts.

    Raises:
        ValueError: If the observation is missing or not flat, the action is not bounded, or a part
            cannot be found.
    """
    action_key = env.action_key if action_key is None else action_key
    return make_tqc_from_specs(
        config,
        env.full_observation_spec_unbatched,
        env.full_action_spec_unbatched[action_key],
        observation_key=observation_key,
        action_key=action_key,
        loss=loss,
        actor=actor,
        critic=critic,
        encoder=encoder,
    )


@checked_arguments
def make_tqc_from_specs(
    config: TQCConfig,
    observation_spec: Composite,
    action_spec: Bounded,
    *,
    observation_key: NestedKey = "observation",
    action_key: NestedKey = "action",
    loss: str | LossFactory | None = None,
    actor: str | ActorFactory | None = None,
    critic: str | CriticFactory | None = None,
    encoder: Encoder | None = None,
) -> TQCAgent:
    """Build an agent without its environment, which may be in another process.

    Args:
        config: The agent's settings.
        observation_spec: The environment's `full_observation_spec_unbatched`.
        action_spec: Spec of one action, `[A]`.
        observation_key: The observation's key in its spec.
        action_key: The action's key in the data.
        loss: This and the following are as in `make_tqc`, as are the result and the errors.
        actor: See above.
        critic: See above.
        encoder: See above.
    """
    if config.device.startswith("cuda"):
        warn_experimental("The learner")
    if isinstance(loss, str):
        config = replace(config, loss=loss)  # the networks' outputs depend on it
    precision = processor_precision() if config.precision == "auto" else config.precision
    config = replace(config, precision=precision)
    make_actor: ActorFactory = find_part("actor", actor or config.actor_network, ACTORS)
    make_critic: CriticFactory = find_part("critic", critic or config.critic, CRITICS)
    make_loss: LossFactory = find_part("loss", loss or config.loss, LOSSES)
    encoder = config.encoder if encoder is None else encoder
    specs = LearnerSpecs(
        observation=observation_spec,
        action=action_spec.to(config.device),
        observation_key=observation_key,
        action_key=action_key,
        encoder=None if encoder is None else make_trained_encoder(encoder).to(config.device),
        image_key=config.image_key,
    )
    policy = make_actor(config, specs)
    critics = [make_critic(config, specs) for _ in range(config.num_critics)]
    loss_module = make_loss(config, policy, critics, specs).to(config.device)
    target_updater = _make_target_updater(config, loss_module)
    optimizer = _make_optimizer(config, loss_module)
    noise = _make_noise(config, specs)
    return TQCAgent(
        config=config,
        actor=policy,
        exploration_policy=TensorDictSequential(policy, noise),
        critics=critics,
        loss=loss_module,
        target_updater=target_updater,
        optimizer=optimizer,
        update=TQCUpdate(
            loss_module,
            optimizer,
            target_updater,
            execution=config.execution,
            precision=precision,
        ),
    )


def _make_target_updater(config: TQCConfig, loss: LossModule) -> SoftUpdate | None:
    has_targets = any(
        name.startswith("target_") and name.endswith("_params") for name, _ in loss.named_children()
    )
    return SoftUpdate(loss, tau=config.tau) if has_targets else None


def _make_optimizer(config: TQCConfig, loss: nn.Module) -> torch.optim.Adam:
    group_of: dict[nn.Parameter, str] = {}
    # A parameter that the actor shares with something else, an encoder for instance, is trained at
    # the other's rate.
    for name, parameter in nn.Module.named_parameters(loss, remove_duplicate=False):
        if parameter.requires_grad and group_of.get(parameter, "actor") == "actor":
            group_of[parameter] = _group(name)
    rates = {"actor": config.actor_lr, "critic": config.critic_lr, "alpha": config.alpha_lr}
    return torch.optim.Adam(
        [
            {"params": parameters, "lr": rate, "name": name}
            for name, rate in rates.items()
            if (parameters := [p for p, group in group_of.items() if group == name])
        ],
        fused=True,
        capturable=config.device.startswith("cuda"),
    )


def _group(name: str) -> str:
    """The optimizer's group of a parameter, from the loss's attribute that holds it."""
    attribute = name.split(".")[0]
    if "alpha" in attribute:
        return "alpha"
    return "actor" if attribute.startswith(("actor", "policy")) else "critic"


def _make_noise(config: TQCConfig, specs: LearnerSpecs) -> AdditiveGaussianModule:
    noise = AdditiveGaussianModule(
        specs.action,
        sigma_init=float(config.exploration_sigma),
        sigma_end=float(config.exploration_sigma),
        action_key=specs.action_key,
        device=torch.device(config.device),
    )
    # Half the range of each action component.
    noise.std = (specs.action.space.high - specs.action.space.low) / 2
    return noise
