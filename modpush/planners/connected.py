"""Connectivity of two points through free cells, without planning a path."""

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from modpush._checks import check_dtype, check_real, check_shape

__all__ = ["are_connected"]


def are_connected(blocked: Tensor, start: Tensor, end: Tensor) -> Tensor:
    """True where a path through free cells joins two points without cutting corners.

    As in the planners, a point in a blocked cell is moved to the nearest free cell.

    Args:
        blocked: `[B, H, W]` bool.
        start: `[B, 2]` (u, v) [px].
        end: `[B, 2]` (u, v) [px].

    Returns:
        `[B]` bool; False where all cells are blocked.

    Raises:
        TypeError: If `blocked` is not a bool tensor, or a point is not a tensor of real numbers.
        ValueError: If a shape differs from the expected one.
    """
    check_dtype("blocked", blocked, torch.bool)
    batch = len(blocked) if blocked.ndim else 1
    check_shape("blocked", blocked, "B, H, W", (batch, *blocked.shape[-2:]))
    for name, point in (("start", start), ("end", end)):
        check_real(name, point, 2)
        check_shape(name, point, "B, 2", (batch, 2))
    rows = zip(
        (~blocked).cpu().numpy().astype(np.uint8),
        start.detach().cpu().numpy(),
        end.detach().cpu().numpy(),
        strict=True,
    )
    return torch.tensor([_connected(*row) for row in rows], dtype=torch.bool, device=blocked.device)


def _connected(free: NDArray[np.uint8], start: NDArray, end: NDArray) -> bool:
    _, labels = cv2.connectedComponents(free, connectivity=4)
    first, last = (_label(labels, point) for point in (start, end))
    return first > 0 and first == last


def _label(labels: NDArray[np.int32], point: NDArray) -> int:
    """Label of the free cell nearest to a point; 0 if there is none."""
    height, width = labels.shape
    u, v = (int(x) for x in np.clip(np.rint(point), 0, (width - 1, height - 1)))
    if labels[v, u]:
        return int(labels[v, u])
    rows, columns = np.nonzero(labels)
    if not len(rows):
        return 0
    nearest = np.argmin((columns - point[0]) ** 2 + (rows - point[1]) ** 2)
    return int(labels[rows[nearest], columns[nearest]])
