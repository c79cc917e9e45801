"""`ImageMemory`: arrays for images, used again."""

import sys

import numpy as np
from numpy.typing import NDArray

from modpush.geometry.camera import CAMERA

__all__ = ["ImageMemory"]


class ImageMemory:
    """Arrays for a batch of images, used again as soon as nobody holds the images in them.

    Asked of the system anew for every step, 2.5 MiB for eight scenes, they cost more (in page
    faults) than what is drawn into them. `torch.from_numpy` keeps its array alive for as long as a
    tensor on the same memory lives, so the arrays' reference counts tell.
    """

    _KEPT = 4  # beyond these, arrays come from the system and go back to it

    def __init__(self, num_envs: int) -> None:
        self._shape = (num_envs, 1, CAMERA.height, CAMERA.width)
        self._arrays: list[tuple[NDArray[np.float32], NDArray[np.uint8]]] = []
        self._free = self._count(self._new())

    def _new(self) -> tuple[NDArray[np.float32], NDArray[np.uint8]]:
        return np.empty(self._shape, np.float32), np.empty(self._shape, np.uint8)

    @staticmethod
    def _count(pair: tuple[NDArray[np.float32], NDArray[np.uint8]]) -> tuple[int, int]:
        return sys.getrefcount(pair[0]), sys.getrefcount(pair[1])

    def take(self) -> tuple[NDArray[np.float32], NDArray[np.uint8]]:
        """Depth and segmentation to write into, `[B, 1, H, W]` each; make tensors of them at once."""
        for pair in self._arrays:
            if self._count(pair) == self._free:
                return pair
        pair = self._new()
        if len(self._arrays) < self._KEPT:
            self._arrays.append(pair)
        return pair
