"""The encoder's latent as an entry of the observation, relative to that of an empty window."""

import torch
from torch import Tensor, nn

from modpush._checks import check_instance
from modpush.mdp.observation_entries import ENTRIES, Entry

__all__ = ["BlankLatent", "latent_entry"]


def latent_entry(encoder: nn.Module) -> Entry:
    """The latent minus the encoder's latent of an empty window, so that free space gives zeros.

    Args:
        encoder: Module `[B, 1, S, S] -> [B, d]`; its `window_size` S is 64 unless it says otherwise.
    """
    check_instance("latent_entry", "encoder", encoder, nn.Module)
    latent = ENTRIES["latent"]
    return Entry(latent.read, latent.scale, BlankLatent(encoder))


class BlankLatent:
    """The encoder's latent of an empty window, `[d]`.

    It is computed on the encoder's device and in evaluation mode: at each call while the encoder can
    be trained, otherwise at the first one, and again once the weights have been changed in place or
    moved. The encoder's training flags stay as they are.

    Args:
        encoder: Module `[B, 1, S, S] -> [B, d]`; it is shared, not copied.
    """

    def __init__(self, encoder: nn.Module) -> None:
        self.encoder = encoder
        # Walking through the modules at every observation would take longer than the observation.
        self._weights = [*encoder.parameters(), *encoder.buffers()]
        self._versions: list[int] | None = None
        self._latent = torch.empty(0)

    def __call__(self) -> Tensor:
        """The latent, `[d]`."""
        # Fused optimizers and `Tensor.data` change weights without a new version.
        if any(weight.requires_grad for weight in self._weights):
            return self._encode()
        versions = [-1 if weight.is_inference() else weight._version for weight in self._weights]
        if versions != self._versions:
            self._latent, self._versions = self._encode(), versions
        return self._latent

    @torch.no_grad()
    def _encode(self) -> Tensor:
        size = int(getattr(self.encoder, "window_size", 64))
        device = self._weights[0].device if self._weights else None
        training = [module for module in self.encoder.modules() if module.training]
        self.encoder.eval()
        try:
            return self.encoder(torch.zeros(1, 1, size, size, device=device))[0]
        finally:
            for module in training:  # those, and none that were frozen on purpose
                module.training = True
