"""`VAELoss`: the loss that trains `DepthVAE`, as a TorchRL loss module."""

from dataclasses import dataclass

import torch
from tensordict import NestedKey, TensorDict, TensorDictBase
from torch import Tensor
from torch.nn.functional import binary_cross_entropy_with_logits
from torchrl.objectives import LossModule

from modpush._arguments import checked_arguments
from modpush._keys import read_key
from modpush._types import NonNegative
from modpush.encoders.base import check_window
from modpush.encoders.vae.model import DepthVAE

__all__ = ["VAELoss", "bernoulli_entropy", "kl_divergence"]


def kl_divergence(mean: Tensor, std: Tensor) -> Tensor:
    """KL divergence from N(mean, std) to N(0, 1) of each number, shaped like both [nat]."""
    return 0.5 * (mean.square() + std.square() - 1.0) - std.log()


def bernoulli_entropy(window: Tensor) -> Tensor:
    """Entropy of pixels taken as probabilities, summed over each window, `[B]` [nat].

    No decoder's negative log-likelihood goes below it: a bar of value 0.75 costs 0.56 nat a pixel
    even where it is reconstructed exactly.
    """
    return -(torch.xlogy(window, window) + torch.xlogy(1 - window, 1 - window)).flatten(1).sum(1)


class VAELoss(LossModule):
    """Negative log-likelihood summed over pixels, and the weighted KL divergence; means over windows.

    Forward returns `loss_reconstruction` and `loss_kl` (to be added up), and without gradient `kl`
    (unweighted) and `kl_per_latent` `[latent_dim]`, all in nat.

    Args:
        vae: The autoencoder to train.
        kl_weight: Weight w of the divergence.

    Raises:
        ValueError: If it is not an autoencoder, or the weight is negative or not finite.
    Source: Sec. IV-A of the paper; w = 0.5 as in the authors' code.
    """

    @dataclass
    class _AcceptedKeys:
        window: NestedKey = "window"

    tensor_keys: _AcceptedKeys
    default_keys = _AcceptedKeys

    @checked_arguments
    def __init__(self, vae: DepthVAE, kl_weight: NonNegative = 0.5) -> None:
        super().__init__()
        self.vae = vae
        self.kl_weight = kl_weight
        self.out_keys = ["loss_reconstruction", "loss_kl", "kl", "kl_per_latent"]

    @property
    def in_keys(self) -> list[NestedKey]:
        """Keys that are read: the window."""
        return [self.tensor_keys.window]

    def _forward_value_estimator_keys(self, **kwargs: object) -> None:
        """Do nothing: there is no value to estimate."""

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Both losses of a batch of windows `[B, 1, 64, 64]`."""
        window = read_key(tensordict, self.tensor_keys.window)
        check_window(window, self.vae.window_size, batched=True)
        mean, std = self.vae.encode(window)
        logits = self.vae.decode(mean + std * torch.randn_like(std))
        likelihood = binary_cross_entropy_with_logits(logits, window, reduction="sum")
        kl_per_latent = kl_divergence(mean, std).mean(0)
        kl = kl_per_latent.sum()
        return TensorDict(
            {
                "loss_reconstruction": likelihood / len(window),
                "loss_kl": self.kl_weight * kl,
                "kl": kl.detach(),
                "kl_per_latent": kl_per_latent.detach(),
            }
        )
