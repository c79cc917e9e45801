"""The networks of actor and critics."""

import torch
from tensordict import TensorDict
from torch import nn
from torchrl.data import Bounded

from modpush.agents import make_actor


def test_log_standard_deviation_is_clamped():
    actor = make_actor(2, Bounded(-1, 1, (1,)), (4,))
    head = [layer for layer in actor.modules() if isinstance(layer, nn.Linear)][-1]
    head.weight.data.zero_()
    for bias, scale in ((50.0, torch.tensor(2.0).exp()), (-50.0, torch.tensor(1e-6))):
        head.bias.data[1] = bias
        data = actor(TensorDict({"observation": torch.zeros(1, 2)}, batch_size=[1]))
        torch.testing.assert_close(data["scale"].squeeze(), scale)
