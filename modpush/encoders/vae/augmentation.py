"""Augmentation of windows to windows of other possible scenes."""

import torch
from torch import Tensor

from modpush._arguments import checked_arguments
from modpush._types import Fraction

__all__ = ["augment_windows"]


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
