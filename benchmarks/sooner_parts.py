"""Parts for `examples/sweeps/sooner.yaml`: ideas for learning sooner that the library does not hold.

Each is named in that file as "benchmarks.sooner_parts:NAME", so run the sweep from the repository's root.
What they came to is in `docs/training.md`.
"""

from typing import Any

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModule
from torch import Tensor, nn
from torchrl.data.replay_buffers.storages import Storage
from torchrl.modules import MLP, BatchRenorm1d, ProbabilisticActor, ValueOperator
from torchrl.objectives import CrossQLoss, LossModule

from modpush.agents.tqc.config import TQCConfig
from modpush.agents.tqc.loss import TQCLoss
from modpush.agents.tqc.scalar_losses import entropy_settings
from modpush.agents.tqc.specs import LearnerSpecs
from modpush.encoders import DepthVAE, Encoder
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


class MirrorPair(Encoder):
    """The shipped autoencoder's latents of a window and of its mirror image, `[B, 64]`."""

    def __init__(self) -> None:
        super().__init__()
        self.encoder = DepthVAE.from_pretrained()
        self.latent_dim = 2 * self.encoder.latent_dim
        self.window_size = self.encoder.window_size

    def forward(self, window: Tensor) -> Tensor:
        """Encode `[B, 1, S, S]` windows, whose columns run along the frame's y axis."""
        both = self.encoder(torch.cat([window, window.flip(-1)]))
        return torch.cat(both.chunk(2), -1)


_ENTRIES_AFTER_LATENT: tuple[tuple[tuple[int, ...], tuple[int, ...]], ...] = (
    ((0, 1), (1, -1)),  # ee_position: x, y
    ((0, 1), (1, -1)),  # ee_axis: cosine, sine
    ((0, 1, 2, 3), (1, -1, 1, -1)),  # subgoal_past: x, y, x, y
    ((0,), (1,)),  # contact
    ((0,), (1,)),  # goal_distance
    ((0,), (1,)),  # path_length
    ((0, 1), (1, -1)),  # object_axis: cosine, sine
    ((0, 3, 2, 1), (1, 1, 1, 1)),  # edges: ahead, left, behind, right
)
_ACTION_SIGNS = (1, -1, -1)  # dx, dy, dyaw


class MirroredTQCLoss(TQCLoss):
    """`TQCLoss` on a batch of which a random half is mirrored at the line from object to sub-goal.

    For observations in the path's frame with the entries of the preset `cpu` but `joint_position`, and
    the latents of `MirrorPair`. The networks never see the second latent: its columns are set to zero
    in the batch, so that weights which begin at zero (`zero_init_latent`) stay there.
    """

    def __init__(self, *args: Any, latent_dim: int, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        single = latent_dim // 2
        order = [*range(single, latent_dim), *range(single)]
        signs = [1] * latent_dim
        for places, entry_signs in _ENTRIES_AFTER_LATENT:
            order += [len(signs) + place for place in places]
            signs += entry_signs
        self.register_buffer("order", torch.tensor(order), persistent=False)
        self.register_buffer("signs", torch.tensor(signs, dtype=torch.float32), persistent=False)
        self.register_buffer("action_signs", torch.tensor(_ACTION_SIGNS), persistent=False)
        self.unseen = slice(single, latent_dim)

    def mirrored(self, observation: Tensor) -> Tensor:
        """The observation `[B, D]` of the mirrored scene."""
        return observation[:, self.order] * self.signs

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Losses of a batch `[B]`, as `TQCLoss`."""
        batch = tensordict.copy()
        half = (torch.rand(len(batch), 1) < 0.5).to(batch["action"].device)
        for key in ("observation", ("next", "observation")):
            observation = torch.where(half, self.mirrored(batch[key]), batch[key])
            observation[:, self.unseen] = 0.0
            batch.set(key, observation)
        action = batch["action"]
        batch.set("action", torch.where(half, action * self.action_signs, action))
        result = super().forward(batch)
        tensordict.set(self.tensor_keys.priority, batch.get(self.tensor_keys.priority))
        return result


def mirrored_tqc_loss(
    config: TQCConfig,
    actor: ProbabilisticActor,
    critics: list[TensorDictModule],
    specs: LearnerSpecs,
) -> LossModule:
    """`MirroredTQCLoss` from the config."""
    latent_dim = specs.observation_dim - sum(len(places) for places, _ in _ENTRIES_AFTER_LATENT)
    loss = MirroredTQCLoss(
        actor,
        critics,
        latent_dim=latent_dim,
        num_qvalue_nets=len(critics),
        top_quantiles_to_drop_per_net=config.top_quantiles_to_drop_per_net,
        **entropy_settings(config, specs),
    )
    loss.set_keys(action=specs.action_key)
    loss.make_value_estimator(gamma=config.gamma)
    return loss


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
