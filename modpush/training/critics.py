"""The critics of a training run, to look at what they expect."""

from collections.abc import Collection, Mapping
from dataclasses import asdict, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import torch
from tensordict import TensorDictBase
from torch import Tensor, nn
from torchrl.envs import EnvBase

from modpush._arguments import checked_arguments
from modpush._validation import from_plain
from modpush._weights import check_weights
from modpush.agents.tqc.build import make_tqc
from modpush.agents.tqc.config import TQCConfig
from modpush.files import reading
from modpush.parts import check_allowed
from modpush.training.config import TrainConfig
from modpush.training.run_folder import CHECKPOINT_KIND, RunFolder, read_checkpoint

__all__ = ["Critics", "load_critics"]


class Critics(nn.Module):
    """The return that the critics expect of an action, averaged over critics and quantiles.

    Args:
        critics: Modules that write `state_action_value`.
    """

    def __init__(self, critics: list[nn.Module]) -> None:
        super().__init__()
        self.critics = nn.ModuleList(critics)

    @torch.no_grad()
    def forward(self, tensordict: TensorDictBase) -> Tensor:
        """The discounted return from here on, `[*B]`, in units of the training reward.

        Args:
            tensordict: With the observation, and the action in the agent's own frame; not changed.
        """
        values = [critic(tensordict.copy())["state_action_value"] for critic in self.critics]
        return torch.stack([value.mean(-1) for value in values]).mean(0)


@checked_arguments
def load_critics(folder: str | Path, env: EnvBase, *, allow: Collection[str] = ()) -> Critics:
    """The critics in the newest checkpoint of a training run.

    Args:
        folder: The run's folder.
        env: The environment that they judge, of the run's agent (`load_agent(folder).make_env(...)`).
        allow: Modules and packages from which the checkpoint may name its networks and loss.

    Raises:
        ValueError: If the folder has no checkpoint, it is damaged or names modules that are not allowed,
            the run's networks were given as objects, which no file can name, they do not fit the
            environment, the critics read an encoder that was trained with them, or the loss has none.
    """
    newest = RunFolder(folder).checkpoints.latest()
    if newest is None:
        raise ValueError(f"load_critics: {folder} holds no checkpoint.")
    with reading(newest, CHECKPOINT_KIND):
        state = read_checkpoint(newest)
        config = from_plain(TrainConfig, state["config"]).tqc
    config = replace(config, device="cpu", execution="eager")
    if config.encoder is not None:
        raise ValueError(
            f"load_critics: the critics in {newest} read the latent of an encoder that was trained with "
            "them, which cannot be loaded alone."
        )
    with reading(newest, CHECKPOINT_KIND):
        check_allowed(f"load_critics: {newest}", asdict(config), allow)
        if config.critic == "mlp":
            _check_size(config, state["loss"])
    agent = make_tqc(config, env)
    if not hasattr(agent.loss, "qvalue_network_params"):
        raise ValueError(f"load_critics: the loss of {newest} has no critics of TorchRL's name.")
    check_weights(f"load_critics: {newest}", agent.loss.state_dict(), state["loss"])
    agent.loss.load_state_dict(state["loss"])
    for stacked, critic in zip(
        agent.loss.qvalue_network_params.unbind(0), agent.critics, strict=True
    ):
        stacked.data.to_module(critic)
    return Critics(agent.critics).eval()


def _check_size(config: TQCConfig, loss: Mapping[str, Any]) -> None:
    """Refuse critics of more weights than a file holds, before memory is allocated for them."""
    outputs = 1 if config.loss in ("sac", "td3") else config.num_quantiles
    layers = pairwise((*config.hidden_sizes, outputs))
    size = config.num_critics * sum(a * b for a, b in layers)
    held = sum(value.numel() for value in loss.values() if isinstance(value, Tensor))
    if size > held:
        raise ValueError(f"its critics would have {size} weights, it holds {held}.")
