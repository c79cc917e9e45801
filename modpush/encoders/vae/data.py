"""`WindowData`, stored windows and their origin, and their augmentation."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from modpush._checks import check_dtype, check_instance, check_shape
from modpush._types import Fraction
from modpush._validation import checked_arguments
from modpush.encoders.base import check_window
from modpush.files import read_tensors, reading, write_tensors

_KIND, _VERSION = "modpush.WindowData", 2


@dataclass(frozen=True, kw_only=True)
class WindowData:
    """`N` windows as integers from 0 to 255, with the config of their generation.

    One level is 0.3 mm of height, far below a depth camera's resolution, in a quarter of a float's
    memory.
    """

    windows: Tensor
    """Windows with S pixels on each side, `[N, S, S]` uint8."""
    family: Tensor
    """Scene family of each window, an index into `config["families"]`, `[N]` uint8."""
    held_out: Tensor
    """Windows that are held out from training, `[N]` bool: those of whole layouts, not single ones."""
    config: dict[str, Any] = field(default_factory=dict)
    """Settings with which the windows were made."""

    def __post_init__(self) -> None:
        """Check shapes and dtypes."""
        for name in ("windows", "family", "held_out"):
            check_instance(name, getattr(self, name), Tensor)
        check_instance("config", self.config, dict)
        check_dtype("family", self.family, torch.uint8)
        check_dtype("held_out", self.held_out, torch.bool)
        shape = self.windows.shape
        if self.windows.dtype != torch.uint8 or len(shape) != 3 or shape[1] != shape[2]:
            raise ValueError(
                f"WindowData: windows must be [N, S, S] uint8, got {list(shape)} "
                f"{self.windows.dtype}."
            )
        for name in ("family", "held_out"):
            check_shape(name, getattr(self, name), "N", (len(self),))

    @property
    def window_size(self) -> int:
        """Side of the windows [px]."""
        return self.windows.shape[-1]

    def __len__(self) -> int:
        return len(self.windows)

    @classmethod
    def from_floats(
        cls, windows: Tensor, family: Tensor, held_out: Tensor, config: dict[str, Any]
    ) -> "WindowData":
        """Round windows to the 256 levels.

        Args:
            windows: `[N, 1, S, S]` float32 in [0, 1].
            family: `[N]` uint8.
            held_out: `[N]` bool.
            config: Settings with which the windows were made.

        Raises:
            TypeError: If the windows are not a float32 tensor.
            ValueError: If a value is NaN or not in [0, 1], or a shape does not fit.
        """
        check_window(windows, windows.shape[-1], batched=True)
        levels = (windows[:, 0] * 255).round().to(torch.uint8)
        return cls(windows=levels, family=family, held_out=held_out, config=config)

    def floats(self, index: Tensor | slice = slice(None)) -> Tensor:
        """Windows for an encoder, `[n, 1, S, S]` float32 in [0, 1]."""
        return self.windows[index].unsqueeze(1).float().div_(255)

    def where(self, mask: Tensor) -> "WindowData":
        """The windows where a mask `[N]` bool is True."""
        check_dtype("mask", mask, torch.bool)
        check_shape("mask", mask, "N", (len(self),))
        return WindowData(
            windows=self.windows[mask],
            family=self.family[mask],
            held_out=self.held_out[mask],
            config=self.config,
        )

    @classmethod
    def join(cls, parts: Sequence["WindowData"]) -> "WindowData":
        """Concatenate data sets of one window size; the config is that of the first."""
        if not isinstance(parts, Sequence) or not parts:
            raise ValueError(f"WindowData.join: parts must be one or more, got {parts!r}.")
        for part in parts:
            check_instance("parts", part, WindowData)
        columns = {
            name: torch.cat([getattr(part, name) for part in parts])
            for name in ("windows", "family", "held_out")
        }
        return cls(**columns, config=parts[0].config)

    def save(self, path: Path | str) -> None:
        """Write one safetensors file, atomically."""
        tensors = {"windows": self.windows, "family": self.family, "held_out": self.held_out}
        write_tensors(path, tensors, _KIND, _VERSION, self.config)

    @classmethod
    def load(cls, path: Path | str) -> "WindowData":
        """Read a file.

        Raises:
            FileNotFoundError: If there is none.
            ValueError: If it is damaged, or of another kind or version.
        """
        with reading(path, _KIND):
            tensors, config = read_tensors(path, _KIND, _VERSION)
            if missing := {"windows", "family", "held_out"} - set(tensors):
                raise ValueError(f"{_KIND}: {path} lacks {sorted(missing)}.")
            return cls(**tensors, config=config)


@checked_arguments
def augment_windows(windows: Tensor, others: Tensor, overlay: Fraction = 0.5) -> Tensor:
    """Rotate and mirror windows at random, and overlay some of them with others.

    All results are windows of possible scenes: a quarter turn or a mirror image of a layout is a
    layout, and the higher of two heights is what a camera sees of two layouts at once. With the
    overlays, an encoder that is trained on the paper's families also represents clutter of other
    families. Blank windows stay blank.

    Args:
        windows: Windows to change, `[B, 1, S, S]`.
        others: Windows for overlays, `[B, 1, S, S]`.
        overlay: Share of the windows with an overlay.

    Returns:
        `[B, 1, S, S]`; uses torch's global generator.

    Raises:
        ValueError: If `overlay` is not in [0, 1] or the shapes differ.
    """
    if windows.shape != others.shape:
        raise ValueError(
            f"augment_windows: others must be shaped like windows {list(windows.shape)}, "
            f"got {list(others.shape)}."
        )
    filled = windows.flatten(1).amax(1) > 0
    chosen = filled & (torch.rand(len(windows)) < overlay).to(windows.device)
    return torch.maximum(_rotated(windows), _rotated(others) * chosen[:, None, None, None])


def _rotated(windows: Tensor) -> Tensor:
    """Each window in one of its eight orientations."""
    out = torch.empty_like(windows)
    for turn, rows in enumerate(torch.randperm(len(windows)).tensor_split(8)):
        some = torch.rot90(windows[rows], turn % 4, (-2, -1))
        out[rows] = some.flip(-1) if turn >= 4 else some
    return out
