"""The encoder's latent as an entry of the observation, relative to that of an empty window."""

from dataclasses import replace

import torch
from torch import Tensor, nn

from modpush._arguments import checked_arguments
from modpush.mdp.observation_entries import ENTRIES, Entry

__all__ = ["BlankLatent", "latent_entry"]


@checked_arguments
def latent_entry(encoder: nn.Module) -> Entry:
    """The latent minus the encoder's latent of an empty window, so that free space gives zeros.

    Args:
        encoder: Module `[B, 1, S, S] -> [B, d]`; its `window_size` S is 64 unless it defines another.
    """
    latent = ENTRIES["latent"]
    return replace(latent, shift=BlankLatent(encoder))


class BlankLatent:
    """The encoder's latent of an empty window, `[d]`.

    It is computed at the first call, on the encoder's device and in evaluation mode, and again once
    the weights have been changed in place, trained or moved; not after `load_state_dict(assign=True)`,
    which puts others in their place. The encoder's training flags stay as they are.

    Args:
        encoder: Module `[B, 1, S, S] -> [B, d]`; it is shared, not copied.
    """

    def __init__(self, encoder: nn.Module) -> None:
        self.encoder = encoder
        self._find_weights()
        self._versions: list[int] = []
        self._last_before = torch.empty(0, device="cpu")
        self._latent: Tensor | None = None

    def _find_weights(self) -> None:
        """Note the tensors that tell whether the encoder has changed."""
        encoder = self.encoder
        # Walking through the modules at every observation would take longer than the observation.
        weights: list[Tensor] = [*encoder.parameters(), *encoder.buffers()]
        self._versioned = [weight for weight in weights if not weight.is_inference()]
        # Fused optimizers change weights without a new version, but then all that they train.
        parameters: list[Tensor] = list(encoder.parameters())
        self._has_parameters = bool(parameters)
        trained = [weight for weight in parameters if weight.requires_grad]
        self._last = (trained or parameters or weights or [torch.empty(0, device="cpu")])[-1]

    def __call__(self) -> Tensor:
        """The latent, `[d]`; the same tensor until the weights change."""
        if not self._has_parameters:
            self._find_weights()  # moving a module puts others in the places of its buffers
        versions = [weight._version for weight in self._versioned]
        if self._latent is None or versions != self._versions or not self._last_is_as_before():
            self._latent, self._versions = self._encode(), versions
            self._last_before = self._last.detach().clone()
        return self._latent

    def _last_is_as_before(self) -> bool:
        now, before = self._last, self._last_before
        alike = now.device == before.device and now.dtype == before.dtype
        return alike and torch.equal(now, before)

    @torch.no_grad()
    def _encode(self) -> Tensor:
        size = int(getattr(self.encoder, "window_size", 64))
        device = self._last.device
        training = [module for module in self.encoder.modules() if module.training]
        self.encoder.eval()
        try:
            blank = torch.zeros(1, 1, size, size, dtype=torch.float32, device=device)
            return self.encoder(blank)[0]
        finally:
            for module in training:  # those, and none that were frozen on purpose
                module.training = True
