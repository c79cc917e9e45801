"""Stored windows and their augmentation, for `collect_windows`, `train_vae` and `report_vae`."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

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
        """
        levels = (windows[:, 0] * 255).round().to(torch.uint8)
        return cls(windows=levels, family=family, held_out=held_out, config=config)

    def floats(self, index: Tensor | slice = slice(None)) -> Tensor:
        """Windows for an encoder, `[n, 1, S, S]` float32 in [0, 1]."""
        return self.windows[index].unsqueeze(1).float().div_(255)

    def where(self, mask: Tensor) -> "WindowData":
        """The windows where a mask `[N]` bool is True."""
        return WindowData(
            windows=self.windows[mask],
            family=self.family[mask],
            held_out=self.held_out[mask],
            config=self.config,
        )

    @classmethod
    def join(cls, parts: Sequence["WindowData"]) -> "WindowData":
        """Concatenate data sets of one window size; the config is that of the first."""
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
            return cls(**tensors, config=config)


def augment_windows(windows: Tensor, others: Tensor, overlay: float = 0.5) -> Tensor:
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
    """
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
