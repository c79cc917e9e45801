"""Random losses and batches, the same for our loss and for TorchRL's."""

from collections.abc import Callable
from typing import Any

import torch
from tensordict import TensorDict
from tensordict.nn import NormalParamExtractor, TensorDictModule
from torch import nn
from torchrl.data import Bounded
from torchrl.modules import MLP, ProbabilisticActor, TanhNormal, ValueOperator
from torchrl.objectives import SoftUpdate

OBS, ACT, ATOMS, CELLS = 6, 2, 7, (16, 12)


def make_actor(
    action_key: Any = "action", observation_key: Any = "observation", **distribution_kwargs: Any
):
    network = nn.Sequential(
        MLP(in_features=OBS, out_features=2 * ACT, num_cells=list(CELLS)), NormalParamExtractor()
    )
    return ProbabilisticActor(
        TensorDictModule(network, in_keys=[observation_key], out_keys=["loc", "scale"]),
        in_keys=["loc", "scale"],
        out_keys=[action_key],
        spec=Bounded(-1, 1, (ACT,)),
        distribution_class=TanhNormal,
        distribution_kwargs=distribution_kwargs,
    )


def make_critic(
    action_key: Any = "action",
    observation_key: Any = "observation",
    value_key: Any = "state_action_value",
    atoms: int = ATOMS,
    **kwargs: Any,
):
    kwargs = {"activation_class": nn.ReLU, "num_cells": list(CELLS), **kwargs}
    network = MLP(in_features=OBS + ACT, out_features=atoms, **kwargs)
    return ValueOperator(network, in_keys=[observation_key, action_key], out_keys=[value_key])


def make_loss(
    cls: type,
    *,
    seed: int = 0,
    num_critics: int = 3,
    critic: Callable[[], Any] = make_critic,
    actor: Callable[[], Any] = make_actor,
    dtype: torch.dtype = torch.float32,
    gamma: float = 0.9,
    **kwargs: Any,
):
    """A loss with its value estimator and updater set, its targets away from its critics."""
    torch.manual_seed(seed)
    critics = [critic() for _ in range(num_critics)]
    kwargs.setdefault("alpha_init", 0.3)
    if kwargs.get("reduction") == "none":
        kwargs["scalar_output_mode"] = "exclude"
    loss = cls(actor(), critics, num_qvalue_nets=num_critics, **kwargs)
    loss.make_value_estimator(gamma=gamma)
    if kwargs.get("delay_qvalue", True):
        SoftUpdate(loss, tau=0.5)
        for target in loss.target_qvalue_network_params.values(True, True):
            target.data.add_(0.1 * torch.randn_like(target))
    return loss.to(dtype)


def make_batch(
    *batch_size: int, seed: int = 1, terminated: bool = True, dtype: torch.dtype = torch.float32
) -> TensorDict:
    """Random transitions, of which some are terminal and some others are cut off (`done` alone)."""
    torch.manual_seed(seed)
    ended = torch.rand(*batch_size, 1) < 0.3 if terminated else torch.zeros(*batch_size, 1) > 1
    batch = {
        "observation": torch.randn(*batch_size, OBS, dtype=dtype),
        "action": torch.rand(*batch_size, ACT, dtype=dtype) * 2 - 1,
        "next": {
            "observation": torch.randn(*batch_size, OBS, dtype=dtype),
            "reward": 2 * torch.randn(*batch_size, 1, dtype=dtype),
            "terminated": ended,
        },
    }
    batch["next"]["done"] = ended | (torch.rand(*batch_size, 1) < 0.3)
    return TensorDict(batch, batch_size=batch_size)


def make_pendulum_batch(seed: int, size: int = 8) -> TensorDict:
    """Random transitions with the widths of `Pendulum-v1`."""
    generator = torch.Generator().manual_seed(seed)
    after = {"observation": torch.randn(size, 3, generator=generator)}
    after |= {"reward": torch.randn(size, 1, generator=generator)}
    after |= {key: torch.zeros(size, 1, dtype=torch.bool) for key in ("done", "terminated")}
    now = {"observation": torch.randn(size, 3, generator=generator)}
    now |= {"action": torch.rand(size, 1, generator=generator) * 4 - 2}
    return TensorDict({**now, "next": after}, batch_size=[size])
