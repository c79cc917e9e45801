"""Encoders by name, and user-defined encoders."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

from torch import nn

from modpush.encoders.base import encoder_sizes
from modpush.encoders.networks.conv_encoder import ConvEncoder
from modpush.encoders.networks.ray_scan import RayScan
from modpush.encoders.vae.model import DepthVAE
from modpush.parts import find_part

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
