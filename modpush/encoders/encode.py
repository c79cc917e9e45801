"""`Encode`: an encoder as a TorchRL transform."""

import torch
from tensordict import NestedKey, TensorDictBase
from torch import nn
from torchrl.data import TensorSpec, Unbounded
from torchrl.envs import Transform

from modpush.encoders.base import check_window

__all__ = ["Encode"]


class Encode(Transform):
    """Writes the latent of the window: one call of the encoder for all scenes, in eval mode.

    The encoder is shared, not copied: where its weights are trained, the transform follows.

    Args:
        encoder: Any module `[B, 1, S, S] -> [B, latent_dim]` that says its `latent_dim`, and its
            `window_size` where that is not 64.
        window_key: Read, `[..., 1, S, S]` float32 in [0, 1].
        latent_key: Written, `[..., latent_dim]` float32.
        grad: Let gradients through to the encoder, for training it end to end.

    Raises:
        TypeError: If the encoder has no `latent_dim`.
    """

    def __init__(
        self,
        encoder: nn.Module,
        window_key: NestedKey = "window",
        latent_key: NestedKey = "latent",
        grad: bool = False,
    ) -> None:
        if not isinstance(getattr(encoder, "latent_dim", None), int):
            raise TypeError(
                f"Encode: encoder must be a module with an int `latent_dim`, got "
                f"{type(encoder).__name__} with "
                f"latent_dim={getattr(encoder, 'latent_dim', None)!r}."
            )
        super().__init__(in_keys=[window_key], out_keys=[latent_key])
        self.encoder = encoder
        self.window_key, self.latent_key, self.grad = window_key, latent_key, grad
        self.latent_dim = int(encoder.latent_dim)  # type: ignore[arg-type]
        self.window_size = int(getattr(encoder, "window_size", 64))

    def _call(self, next_tensordict: TensorDictBase) -> TensorDictBase:
        window = next_tensordict.get(self.window_key, None)
        if window is None:
            raise KeyError(
                f"Encode: {self.window_key!r} is missing; there is "
                f"{sorted(map(str, next_tensordict.keys(True, True)))}."
            )
        check_window(window, self.window_size, "Encode")
        batch = window.reshape(-1, *window.shape[-3:])
        training = [module for module in self.encoder.modules() if module.training]
        if training:
            self.encoder.eval()  # a latent must not depend on which scenes share the call
        try:
            with torch.set_grad_enabled(self.grad and torch.is_grad_enabled()):
                latent = self.encoder(batch)
        finally:
            for module in training:  # those, and none that were frozen on purpose
                module.training = True
        next_tensordict.set(self.latent_key, latent.reshape(*window.shape[:-3], self.latent_dim))
        return next_tensordict

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        return self._call(tensordict_reset)

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Encode stored windows."""
        return self._call(tensordict)

    def transform_observation_spec(self, observation_spec: TensorSpec) -> TensorSpec:
        """Add the latent."""
        observation_spec[self.latent_key] = Unbounded(
            shape=(*observation_spec.shape, self.latent_dim),
            dtype=torch.float32,
            device=observation_spec.device,
        )
        return observation_spec
