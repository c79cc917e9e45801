"""The encoders by name, and `Encode`: from the window to its latent."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import torch
from tensordict import NestedKey, TensorDictBase
from torch import nn
from torchrl.data import TensorSpec

from modpush._checks import check_spec_has, read_key
from modpush._precision import autocast
from modpush._state import weights_hash
from modpush._transforms import StatelessTransform, add_unbounded, write_scenes_reset
from modpush._validation import checked_arguments
from modpush.encoders.base import as_floats, check_window, encoder_sizes, evaluating
from modpush.encoders.networks import ConvEncoder, RayScan
from modpush.encoders.vae.model import DepthVAE
from modpush.parts import find_part

_FEW = 4
"""Number of images from which on a latent's last bits do not depend on the number in the call: matrix
products of fewer rows sum in another order."""


class Encode(StatelessTransform):
    """Writes the latent of the window: one call of the encoder for all scenes, in eval mode.

    The encoder is shared, not copied: the transform uses its weights as they are trained.

    Args:
        encoder: Any module `[B, 1, S, S] -> [B, latent_dim]` with the attributes `latent_dim` and, if
            S is not 64, `window_size`.
        window_key: Read, `[..., 1, S, S]` float32 in [0, 1], or uint8, in which 255 stands for 1.
        latent_key: Written, `[..., latent_dim]` float32.
        mirrored_key: Written if given, `[..., latent_dim]` float32: the latent of the window mirrored
            at the x axis of its frame, for `modpush.mdp.MirroredObservation`.
        grad: Propagate gradients to the encoder, for training it end to end.

    Raises:
        TypeError: If the encoder has no `latent_dim`.
    """

    @checked_arguments
    def __init__(
        self,
        encoder: nn.Module,
        window_key: NestedKey = "window",
        latent_key: NestedKey = "latent",
        grad: bool = False,
        *,
        mirrored_key: NestedKey | None = None,
    ) -> None:
        self.latent_dim, self.window_size, _ = encoder_sizes(encoder)
        out_keys = [latent_key] if mirrored_key is None else [latent_key, mirrored_key]
        super().__init__(in_keys=[window_key], out_keys=out_keys)
        self.encoder, self.mirrored_key = encoder, mirrored_key
        self.window_key, self.latent_key, self.grad = window_key, latent_key, grad

    def describe(self) -> dict[str, Any]:
        """Class of the encoder and hash of its weights."""
        kind = type(self.encoder)
        name = f"{kind.__module__}:{kind.__qualname__}"
        return {"encoder": {"class": name, "weights": weights_hash(self.encoder)}}

    def _call(self, next_tensordict: TensorDictBase) -> TensorDictBase:
        window = as_floats(read_key(next_tensordict, self.window_key))
        check_window(window, self.window_size)
        batch = window.reshape(-1, *window.shape[-3:])
        if self.mirrored_key is not None:
            batch = torch.cat([batch, batch.flip(-1)])  # its columns run along the frame's y
        # In eval mode, since a latent must not depend on the other scenes of the batch.
        with (
            evaluating(self.encoder),
            autocast(batch.device),
            torch.set_grad_enabled(self.grad and torch.is_grad_enabled()),
        ):
            latent = self.encoder(batch).to(batch.dtype)
        if latent.shape != (len(batch), self.latent_dim):
            raise ValueError(
                f"Encode: the encoder must return [B, latent_dim] = "
                f"[{len(batch)}, {self.latent_dim}], got {list(latent.shape)}."
            )
        for key, part in zip(self.out_keys, latent.chunk(len(self.out_keys)), strict=True):
            next_tensordict.set(key, part.reshape(*window.shape[:-3], self.latent_dim))
        return next_tensordict

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        keys = self.in_keys, self.out_keys
        scenes = _FEW // len(self.out_keys)  # each has a mirror image where these are encoded, too
        return write_scenes_reset(self._call, tensordict, tensordict_reset, *keys, at_least=scenes)

    def transform_observation_spec(self, observation_spec: TensorSpec) -> TensorSpec:
        """Add the latents."""
        check_spec_has(observation_spec, self.in_keys)
        for key in self.out_keys:
            add_unbounded(observation_spec, key, self.latent_dim)
        return observation_spec


ENCODERS: dict[str, Callable[[], nn.Module | None]] = {
    "vae": DepthVAE.from_pretrained,
    "rays": RayScan,
    "conv": ConvEncoder,
    "none": lambda: None,
}
"""Factory of each encoder, by name: the shipped `DepthVAE`, `RayScan`, `ConvEncoder`, or none."""


def names_a_file(encoder: str | Path) -> bool:
    """True if a text or path stands for a file of a `DepthVAE`, which need not exist."""
    text = str(encoder)
    return text.endswith(".safetensors") or "/" in text or Path(text).is_file()


def make_encoder(encoder: Any) -> nn.Module | None:
    """Make an encoder from its name, file or `"module:name"`, or check an encoder object.

    Args:
        encoder: A name in `ENCODERS`; the path of a trained `DepthVAE`; `"module:name"` of an
            encoder, or of a class or function that returns one without arguments; or such an object
            itself. An encoder is a module with the attribute `latent_dim`, see `Encoder`.

    Returns:
        The encoder; None for None and for the name "none".

    Raises:
        ValueError: If there is no such encoder, or the file is damaged.
        TypeError: If the object is not a module with a `latent_dim`.
    """
    if encoder is None:
        return None
    if isinstance(encoder, str | Path) and encoder not in ENCODERS and names_a_file(encoder):
        if not Path(encoder).is_file():
            raise ValueError(
                f"encoder must be an existing file, one of {sorted(ENCODERS)} or "
                f"'module:name', got {str(encoder)!r}, which is not in {Path.cwd()}. An agent's "
                "environment can be given the encoder as a part, parts={'encoder': ...}."
            )
        return DepthVAE.from_pretrained(encoder)
    text = str(encoder) if isinstance(encoder, Path) else encoder
    found = find_part("encoder", text, ENCODERS)
    if isinstance(found, type) or (callable(found) and not isinstance(found, nn.Module)):
        found = found()
    if found is not None:
        encoder_sizes(found)
    return found
