"""Training an image encoder end to end: the critics' loss trains it, the actor reads its latent.

Source: the arrangement of DrQ (Kostrikov et al. 2020): one encoder for actor and critics, trained by
the critics' loss alone, and a slowly moving copy of it for the targets.
"""

from collections.abc import Callable
from typing import Any

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModule, TensorDictParams, dispatch
from tensordict.utils import NestedKey, unravel_key
from torch import Tensor, nn

from modpush._checks import check_instance, read_key
from modpush._precision import autocast
from modpush.agents.tqc.loss import TQCLoss
from modpush.parts import find_part

LATENT_KEY = "image_latent"
"""Key under which critics read the latent that `EncoderTQCLoss` writes."""


def encode_images(encoder: nn.Module, images: Tensor) -> Tensor:
    """Latents of images that are stored as bytes or as floats.

    Args:
        encoder: Maps `[P, C, H, W]` float32 in [0, 1] to `[P, latent_dim]`.
        images: `[*B, C, H, W]`; uint8 values stand for themselves divided by 255.

    Returns:
        Latents, `[*B, latent_dim]`.

    Raises:
        TypeError: If the images are not a tensor, or neither uint8 nor floating point.
        ValueError: If they have fewer than three dimensions.
    """
    check_instance("images", images, Tensor)
    if images.ndim < 3:
        raise ValueError(f"encode_images: images must be [*B, C, H, W], got {list(images.shape)}.")
    if images.dtype == torch.uint8:
        images = images.float() / 255
    elif not images.is_floating_point():
        raise TypeError(
            f"encode_images: images must be uint8 or floating point, got {images.dtype}."
        )
    with autocast(images.device):
        latent = encoder(images.reshape(-1, *images.shape[-3:])).to(images.dtype)
    return latent.reshape(*images.shape[:-3], latent.shape[-1])


def make_trained_encoder(encoder: str | nn.Module | Callable[[], nn.Module]) -> nn.Module:
    """The encoder that a text, a class or function that makes one, or a module stands for."""
    module = find_part("encoder", encoder, {})
    if callable(module) and not isinstance(module, nn.Module):
        module = module()
    if not isinstance(module, nn.Module) or not isinstance(
        getattr(module, "latent_dim", None), int
    ):
        raise TypeError(
            "make_tqc: encoder must be a module with an int `latent_dim`, got "
            f"{type(module).__name__} with latent_dim={getattr(module, 'latent_dim', None)!r}."
        )
    return module


class EncodedNetwork(nn.Module):
    """A network that reads an observation and an image's latent, without gradient to the encoder.

    Args:
        encoder: See `encode_images`.
        network: Maps `[*B, D + latent_dim]` to its outputs.
    """

    def __init__(self, encoder: nn.Module, network: nn.Module) -> None:
        super().__init__()
        self.encoder = encoder
        self.network = network

    def forward(self, observation: Tensor, images: Tensor) -> Any:
        """`[*B, D]` and `[*B, C, H, W]` to the network's outputs."""
        with torch.no_grad():
            latent = encode_images(self.encoder, images)
        return self.network(torch.cat([observation, latent], -1))


class EncoderTQCLoss(TQCLoss):
    """`TQCLoss` that trains an image encoder with the critics.

    Each batch is encoded once for all critics. The critics read the latent under `latent_key`:
    their loss trains the encoder, their targets use the encoder's target copy, which `SoftUpdate`
    moves like the target critics. No gradient of the actor's loss reaches the encoder.

    Args:
        actor_network: The actor; it holds the same encoder (see `EncodedNetwork`).
        qvalue_network: The critics, which read `latent_key`.
        encoder: See `encode_images`.
        image_key: Key of the images, `[*B, C, H, W]`, read here and under `"next"`.
        latent_key: Key of the latents, `[*B, latent_dim]`, which are not written into the batch.
        **kwargs: Arguments of `TQCLoss`.
    """

    encoder: TensorDictModule
    encoder_params: TensorDictParams
    target_encoder_params: TensorDictParams
    _in_keys: list[NestedKey] | None

    def __init__(
        self,
        actor_network: Any,
        qvalue_network: Any,
        *,
        encoder: nn.Module,
        image_key: NestedKey = "window",
        latent_key: NestedKey = LATENT_KEY,
        **kwargs: Any,
    ) -> None:
        self.image_key, self.latent_key = image_key, latent_key
        super().__init__(actor_network, qvalue_network, **kwargs)
        self.convert_to_functional(encoder, "encoder", create_target_params=True)

    def _set_in_keys(self) -> None:
        super()._set_in_keys()
        kept = [key for key in self._in_keys or [] if key != self.latent_key]
        images = [self.image_key, ("next", self.image_key)]
        self._in_keys = [*kept, *(key for key in images if key not in kept)]

    @dispatch
    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Losses of a batch `[*B]`; the priorities are written into it."""
        batch = tensordict.copy()
        batch.set(self.latent_key, self._encode(self.encoder_params, batch, self.image_key))
        with torch.no_grad():
            key = unravel_key(("next", self.image_key))
            latent = self._encode(self.target_encoder_params, batch, key)
        batch.set(unravel_key(("next", self.latent_key)), latent)
        output = super().forward(batch)
        tensordict.set(self.tensor_keys.priority, batch.get(self.tensor_keys.priority))
        return output

    def actor_loss(self, tensordict: TensorDictBase) -> tuple[Tensor, dict[str, Tensor]]:
        """Actor loss, which holds the encoder fixed."""
        detached = tensordict.copy()
        detached.set(self.latent_key, detached.get(self.latent_key).detach())
        return super().actor_loss(detached)

    def _encode(self, params: TensorDictParams, batch: TensorDictBase, key: NestedKey) -> Tensor:
        images = read_key(batch, key)
        with params.to_module(self.encoder, preserve_module_state=False):
            return encode_images(self.encoder, images)
