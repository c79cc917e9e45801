"""The parts of an agent by name, actor networks, critic networks and losses, and their specs.

A part of your own is a function of the same signature, given as an object or as "module:name".
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any

from tensordict.nn import TensorDictModule
from tensordict.utils import NestedKey
from torch import nn
from torchrl.data import Bounded, Composite
from torchrl.modules import ProbabilisticActor, ValueOperator
from torchrl.objectives import LossModule, SACLoss, TD3Loss

from modpush.agents.tqc.config import TQCConfig
from modpush.agents.tqc.encoder import EncoderTQCLoss
from modpush.agents.tqc.loss import TQCLoss
from modpush.agents.tqc.networks import make_actor, make_critic


@dataclass(frozen=True, kw_only=True)
class LearnerSpecs:
    """Specs and keys that the networks and the loss read and write; an argument of their factories."""

    observation: Composite
    """Specs of everything that the environment observes, without batch dimensions."""
    action: Bounded
    """Spec of one action, `[A]`."""
    observation_key: NestedKey = "observation"
    """Key of the flat observation, `[*B, D]`."""
    action_key: NestedKey = "action"
    """Key of the action, `[*B, A]`."""
    encoder: nn.Module | None = None
    """Image encoder to be trained with the critics, or None; it has an int `latent_dim`."""
    image_key: NestedKey = "window"
    """Key of the images that the encoder reads, `[*B, C, H, W]`."""

    @property
    def observation_dim(self) -> int:
        """Width of the flat observation.

        Raises:
            ValueError: If there is no such observation, or it is not flat.
        """
        spec = self.observation.get(self.observation_key, None)
        if spec is None:
            keys = list(self.observation.keys(True, True))
            raise ValueError(
                f"make_tqc: observation_key {self.observation_key!r} not found, the env has {keys}."
            )
        if len(spec.shape) != 1:
            raise ValueError(
                f"make_tqc: {self.observation_key!r} must be a flat observation [D], got shape "
                f"{tuple(spec.shape)}; flatten it with torchrl's FlattenObservation or CatTensors."
            )
        return spec.shape[0]

    @property
    def latent_dim(self) -> int:
        """Width of the encoder's latent, 0 without an encoder."""
        return 0 if self.encoder is None else int(self.encoder.latent_dim)  # type: ignore[arg-type]


ActorFactory = Callable[[TQCConfig, LearnerSpecs], ProbabilisticActor]
"""Makes the policy. It must write the action within its bounds, and beside it the parameters of the
distribution; it may read any observed key."""
CriticFactory = Callable[[TQCConfig, LearnerSpecs], TensorDictModule]
"""Makes one critic; called once per critic. It reads any observed key and the action, and writes
`state_action_value`: return quantiles `[*B, n]`, or for losses with scalar critics `[*B, 1]`."""
LossFactory = Callable[
    [TQCConfig, ProbabilisticActor, list[TensorDictModule], LearnerSpecs], LossModule
]
"""Makes the loss from the config, the actor, the critics and the specs. Its outputs named `loss_*`
are minimised. It must have its value estimator and its keys set. Parameters whose names begin with
`actor` or `policy` learn at `actor_lr`, those of a name with `alpha` at `alpha_lr`, all others at
`critic_lr`. Target parameters, if there are any, are moved by `SoftUpdate`."""


def mlp_actor(
    config: TQCConfig, specs: LearnerSpecs, *, deterministic: bool = False
) -> ProbabilisticActor:
    """A multilayer perceptron over the observation and, if there is an encoder, its latent."""
    return make_actor(
        specs.observation_dim,
        specs.action,
        config.hidden_sizes,
        observation_key=specs.observation_key,
        action_key=specs.action_key,
        encoder=specs.encoder,
        image_key=specs.image_key,
        deterministic=deterministic,
        device=config.device,
    )


def mlp_critic(config: TQCConfig, specs: LearnerSpecs) -> ValueOperator:
    """A multilayer perceptron over observation, action and, if there is an encoder, its latent.

    It predicts one value for the losses "sac" and "td3", and `num_quantiles` for others.
    """
    return make_critic(
        specs.observation_dim,
        specs.action.shape[-1],
        1 if config.loss in ("sac", "td3") else config.num_quantiles,
        config.hidden_sizes,
        layer_norm=config.layer_norm,
        latent_dim=specs.latent_dim,
        observation_key=specs.observation_key,
        action_key=specs.action_key,
        device=config.device,
    )


def tqc_loss(
    config: TQCConfig,
    actor: ProbabilisticActor,
    critics: list[TensorDictModule],
    specs: LearnerSpecs,
) -> TQCLoss:
    """`TQCLoss`, or `EncoderTQCLoss` where there is an encoder to train."""
    settings = {
        "num_qvalue_nets": len(critics),
        "top_quantiles_to_drop_per_net": config.top_quantiles_to_drop_per_net,
        "skip_done_states": config.skip_done_states,
        **entropy_settings(config, specs),
    }
    loss = (
        TQCLoss(actor, critics, **settings)
        if specs.encoder is None
        else EncoderTQCLoss(
            actor, critics, encoder=specs.encoder, image_key=specs.image_key, **settings
        )
    )
    return _complete(loss, config, specs)


def scalar_loss(
    config: TQCConfig,
    actor: ProbabilisticActor,
    critics: list[TensorDictModule],
    specs: LearnerSpecs,
) -> LossModule:
    """TorchRL's `TD3Loss` if the config's loss is "td3", else `SACLoss`: critics of one value each.

    With TD3 the actor learns in every update, where the publication has it learn in every second one.
    Source: Haarnoja et al. (2018), arXiv 1812.05905; Fujimoto et al. (2018), arXiv 1802.09477.
    """
    if specs.encoder is not None:
        raise ValueError(
            f"make_tqc: loss must be 'tqc' to train an image encoder, got {config.loss!r}."
        )
    kind: Any = SACLoss
    settings = {"skip_done_states": config.skip_done_states, **entropy_settings(config, specs)}
    if config.loss == "td3":
        kind = TD3Loss
        settings = {"action_spec": specs.action, "delay_actor": True, "delay_qvalue": True}
    loss = kind(actor, critics, num_qvalue_nets=len(critics), loss_function="l2", **settings)
    return _complete(loss, config, specs)


def entropy_settings(config: TQCConfig, specs: LearnerSpecs) -> dict[str, Any]:
    """Arguments of the losses with an entropy temperature, from the config."""
    automatic = config.target_entropy == "auto"
    return {
        "action_spec": specs.action,
        "alpha_init": config.alpha_init,
        "min_alpha": config.min_alpha,
        "max_alpha": config.max_alpha,
        "fixed_alpha": config.fixed_alpha,
        "target_entropy": -float(specs.action.shape[-1]) if automatic else config.target_entropy,
    }


def _complete(loss: Any, config: TQCConfig, specs: LearnerSpecs) -> Any:
    loss.set_keys(action=specs.action_key)
    loss.make_value_estimator(gamma=config.gamma)
    return loss


ACTORS: Mapping[str, ActorFactory] = {
    "mlp": mlp_actor,
    "deterministic_mlp": partial(mlp_actor, deterministic=True),
}
"""Actor networks by name; the output of the deterministic one is the action, for TD3."""
CRITICS: Mapping[str, CriticFactory] = {"mlp": mlp_critic}
"""Critic networks by name."""
LOSSES: Mapping[str, LossFactory] = {"tqc": tqc_loss, "sac": scalar_loss, "td3": scalar_loss}
"""Losses by name."""
