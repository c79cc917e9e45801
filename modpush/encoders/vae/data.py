"""`WindowData`: stored windows, with where they come from."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from modpush.encoders.window import WINDOW_SIZE
from modpush.files import read_tensors, write_tensors

__all__ = ["WindowData"]

_KIND, _VERSION = "modpush.WindowData", 1


@dataclass(frozen=True, kw_only=True)
class WindowData:
    """`N` windows as whole numbers from 0 to 255, one file with the config that made it.

    A level is 0.3 mm of height: far below what any depth camera tells, and a quarter of the size.
    """

    windows: Tensor
    """`[N, 64, 64]` uint8."""
    family: Tensor
    """`[N]` uint8, index into `config["families"]`: which scene family a window shows."""
    held_out: Tensor
    """`[N]` bool: not to be trained on. Whole layouts are held out, not single windows."""
    config: dict[str, Any] = field(default_factory=dict)
    """What made them."""

    def __post_init__(self) -> None:
        """Check shapes and dtypes."""
        size = WINDOW_SIZE
        if self.windows.dtype != torch.uint8 or self.windows.shape[1:] != (size, size):
            raise ValueError(
                f"WindowData: windows must be [N, {size}, {size}] uint8, got "
                f"{list(self.windows.shape)} {self.windows.dtype}."
            )
        for name in ("family", "held_out"):
            if getattr(self, name).shape != (len(self),):
                raise ValueError(
                    f"WindowData: {name} must be [{len(self)}], "
                    f"got {list(getattr(self, name).shape)}."
                )

    def __len__(self) -> int:
        return len(self.windows)

    @classmethod
    def from_floats(
        cls, windows: Tensor, family: Tensor, held_out: Tensor, config: dict[str, Any]
    ) -> "WindowData":
        """Round windows `[N, 1, 64, 64]` in [0, 1] to the 256 levels."""
        levels = (windows[:, 0] * 255).round().to(torch.uint8)
        return cls(windows=levels, family=family, held_out=held_out, config=config)

    def floats(self, index: Tensor | slice = slice(None)) -> Tensor:
        """Windows as an encoder takes them, `[n, 1, 64, 64]` float32 in [0, 1]."""
        return self.windows[index].unsqueeze(1).float().div_(255)

    def where(self, mask: Tensor) -> "WindowData":
        """Only those where the mask `[N]` says so."""
        return WindowData(
            windows=self.windows[mask],
            family=self.family[mask],
            held_out=self.held_out[mask],
            config=self.config,
        )

    @classmethod
    def join(cls, parts: Sequence["WindowData"]) -> "WindowData":
        """All parts in one, with the first one's config."""
        columns = {
            name: torch.cat([getattr(part, name) for part in parts])
            for name in ("windows", "family", "held_out")
        }
        return cls(**columns, config=parts[0].config)

    def save(self, path: Path | str) -> None:
        """Write one safetensors file, whole or not at all."""
        tensors = {"windows": self.windows, "family": self.family, "held_out": self.held_out}
        write_tensors(path, tensors, _KIND, _VERSION, self.config)

    @classmethod
    def load(cls, path: Path | str) -> "WindowData":
        """Read a file.

        Raises:
            FileNotFoundError: If there is none.
            ValueError: If it is cut short, of another kind, version or window size.
        """
        tensors, config = read_tensors(path, _KIND, _VERSION)
        if missing := {"windows", "family", "held_out"} - set(tensors):
            raise ValueError(f"{_KIND}: {path} lacks {sorted(missing)}.")
        return cls(**tensors, config=config)
