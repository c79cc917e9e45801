"""Parts for `examples/sweeps/sooner.yaml`: ideas for learning sooner that the library does not hold.

Each is named in that file as "benchmarks.sooner_parts:NAME", so run the sweep from the repository's root.
What they came to is in `docs/results/training/README.md`.
"""

from typing import Any

import torch
from tensordict.nn import TensorDictModule
from torch import Tensor, nn
from torchrl.data.replay_buffers.storages import Storage
from torchrl.modules import MLP, BatchRenorm1d, ProbabilisticActor, ValueOperator
from torchrl.objectives import CrossQLoss, LossModule

from modpush.agents.tqc.config import TQCConfig
from modpush.agents.tqc.factories import entropy_settings
from modpush.agents.tqc.specs import LearnerSpecs
from modpush.replay import AttentiveSampler, ReplayConfig

NUM_DEMONSTRATIONS = 10_000
"""The scripted pusher's transitions, the first in the buffer: the preset's `learning_starts`."""


class HalfDemonstrations(AttentiveSampler):
    """Half of each batch from the scripted pusher's transitions, half by attention from all.

    Source: Ball et al. (2023), arXiv 2302.02948, "symmetric sampling".
    """

    def __init__(self, config: ReplayConfig) -> None:
        super().__init__(config.k, similarity=config.similarity, num_queries=config.num_queries)

    def sample(self, storage: Storage, batch_size: int) -> tuple[Tensor, dict[str, Any]]:
        """Draw a batch; the buffer must not have come round to its first transitions again."""
        demonstrations = torch.randint(
            min(NUM_DEMONSTRATIONS, len(storage)), [batch_size // 2], generator=storage._rng
        )
        index, _ = super().sample(storage, batch_size - len(demonstrations))
        return torch.cat([index, demonstrations.to(index)]), {}


def crossq_critic(config: TQCConfig, specs: LearnerSpecs) -> ValueOperator:
    """A critic of one value with TorchRL's batch renormalisation after each hidden layer."""
    network = MLP(
        in_features=specs.observation_dim + specs.action.shape[-1],
        out_features=1,
        num_cells=list(config.hidden_sizes),
        activation_class=nn.ReLU,
        norm_class=BatchRenorm1d,
        norm_kwargs=[
            {"num_features": width, "warmup_steps": 1000} for width in config.hidden_sizes
        ],
    )
    return ValueOperator(network, in_keys=[specs.observation_key, specs.action_key])


def crossq_loss(
    config: TQCConfig,
    actor: ProbabilisticActor,
    critics: list[TensorDictModule],
    specs: LearnerSpecs,
) -> LossModule:
    """TorchRL's `CrossQLoss`: no target networks, both states of a transition in one batch.

    Source: Bhatt et al. (2024), arXiv 1902.05605.
    """
    loss = CrossQLoss(
        actor,
        critics,
        num_qvalue_nets=len(critics),
        loss_function="l2",
        **entropy_settings(config, specs),
    )
    loss.set_keys(action=specs.action_key)
    loss.make_value_estimator(gamma=config.gamma)
    return loss
