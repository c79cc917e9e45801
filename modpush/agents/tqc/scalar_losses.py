"""SAC's and TD3's losses, TorchRL's own, for comparison with TQC's."""

from typing import Any

from tensordict.nn import TensorDictModule
from torchrl.modules import ProbabilisticActor
from torchrl.objectives import LossModule, SACLoss, TD3Loss

from modpush.agents.tqc.config import TQCConfig
from modpush.agents.tqc.specs import LearnerSpecs

__all__ = ["entropy_settings", "sac_loss", "td3_loss"]


def sac_loss(
    config: TQCConfig,
    actor: ProbabilisticActor,
    critics: list[TensorDictModule],
    specs: LearnerSpecs,
) -> SACLoss:
    """TorchRL's `SACLoss`: critics of one value each, of which targets take the least.

    Raises:
        ValueError: If an image encoder is to be trained, which only the loss "tqc" does.
    Source: Haarnoja et al. (2018), arXiv 1812.05905.
    """
    loss = SACLoss(
        actor,
        critics,
        num_qvalue_nets=len(critics),
        loss_function="l2",
        skip_done_states=config.skip_done_states,
        **entropy_settings(config, specs),
    )
    return _complete(loss, config, specs)


def td3_loss(
    config: TQCConfig,
    actor: ProbabilisticActor,
    critics: list[TensorDictModule],
    specs: LearnerSpecs,
) -> TD3Loss:
    """TorchRL's `TD3Loss`, with its noise on the target's actions and a target actor.

    The actor learns in every update, where the publication has it learn in every second one.

    Raises:
        ValueError: If an image encoder is to be trained, which only the loss "tqc" does.
    Source: Fujimoto et al. (2018), arXiv 1802.09477.
    """
    loss = TD3Loss(
        actor,
        critics,
        num_qvalue_nets=len(critics),
        loss_function="l2",
        action_spec=specs.action,
        delay_actor=True,
        delay_qvalue=True,
    )
    return _complete(loss, config, specs)


def entropy_settings(config: TQCConfig, specs: LearnerSpecs) -> dict[str, Any]:
    """What the losses with an entropy temperature take from the config."""
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
    if specs.encoder is not None:
        raise ValueError(
            f"make_tqc: loss must be 'tqc' to train an image encoder, got {config.loss!r}."
        )
    assert isinstance(loss, LossModule)
    loss.set_keys(action=specs.action_key)
    loss.make_value_estimator(gamma=config.gamma)
    return loss
