"""Windows that might as well have been seen."""

import torch
from torch import Tensor

__all__ = ["augment_windows"]


def augment_windows(windows: Tensor, others: Tensor, overlay: float = 0.5) -> Tensor:
    """Quarter turns, mirror images, and two scenes laid over each other; random, batch by batch.

    All three make windows of scenes that could stand on the table: obstacles know no handedness and
    no direction, and the higher of two heights is what a camera sees of two layouts at once. The
    last is what lets an encoder trained on the paper's simple families serve in clutter it has not
    seen. Blank windows stay blank.

    Args:
        windows: `[B, 1, S, S]`.
        others: `[B, 1, S, S]`, laid over the first.
        overlay: Share of the windows that get another laid over.

    Returns:
        `[B, 1, S, S]`; uses torch's global generator.

    Raises:
        ValueError: If `overlay` is not in [0, 1] or the shapes differ.
    """
    if not 0 <= overlay <= 1:
        raise ValueError(f"augment_windows: overlay must lie in [0, 1], got {overlay}.")
    if windows.shape != others.shape:
        raise ValueError(
            f"augment_windows: others must be shaped like windows {list(windows.shape)}, "
            f"got {list(others.shape)}."
        )
    seen = windows.flatten(1).amax(1) > 0
    chosen = seen & (torch.rand(len(windows)) < overlay).to(windows.device)
    together = torch.maximum(_turned(windows), _turned(others) * chosen[:, None, None, None])
    return together


def _turned(windows: Tensor) -> Tensor:
    """Each window in one of its eight orientations."""
    out = torch.empty_like(windows)
    for turn, rows in enumerate(torch.randperm(len(windows)).tensor_split(8)):
        some = torch.rot90(windows[rows], turn % 4, (-2, -1))
        out[rows] = some.flip(-1) if turn >= 4 else some
    return out
