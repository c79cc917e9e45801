"""`ObjectFinder`: places where a known object may stand, by its outline in the height map."""

import math

import cv2
import numpy as np
from numpy.typing import NDArray

from modpush.deploy.height_map import HeightMap
from modpush.envs.scenes.objects import PushedObject

_YAWS = 24  # of a whole turn
_SHRINK = 2  # cells of the map to a cell in which is searched
_LEVEL = 0.008
"""Difference of a height from the object's up to which it may be its top [m]."""
_KNOWN = 0.012
"""Difference from a known obstacle's height up to which a cell is taken for it [m]."""
_LEAST = 0.3
"""Least agreement, of at most 1, of a place that is looked at more closely."""
_RING = 2  # width of the border around the outline, which the top must not reach [cells]


class ObjectFinder:
    """Compares the object's top, at all yaw angles, with all places of a height map of `cell` [m]."""

    def __init__(self, item: PushedObject, cell: float) -> None:
        self._height = item.height
        turns = 1 if item.symmetry == 0 else max(1, round(_YAWS / item.symmetry))
        self._yaws = np.arange(turns) * (2 * math.pi / (turns * max(1, item.symmetry)))
        self._kernels = [_kernel(item, yaw, cell * _SHRINK) for yaw in self._yaws]

    def candidates(self, heights: HeightMap, count: int) -> NDArray[np.float64]:
        """The most likely poses in the latest image, best first, `[n, 3]` [m, m, rad], `n <= count`."""
        latest, shown = heights.latest, heights.shown
        known = (heights.heights > _LEVEL) & (np.abs(latest - heights.heights) < _KNOWN)
        top = shown & (np.abs(latest - self._height) < _LEVEL) & ~known
        evidence = np.where(top, 1.0, np.where(shown, -1.0, 0.0)).astype(np.float32)
        side = heights.view.width // _SHRINK, heights.view.height // _SHRINK
        evidence = cv2.resize(evidence, side, interpolation=cv2.INTER_AREA)
        top_share = np.maximum(evidence, 0.0)
        best, number = np.full(evidence.shape, -np.inf, np.float32), np.zeros(evidence.shape, int)
        for i, (inside, ring) in enumerate(self._kernels):
            border = {"borderType": cv2.BORDER_CONSTANT}
            found = cv2.filter2D(evidence, -1, inside, **border)
            found -= cv2.filter2D(top_share, -1, ring, **border)
            better = found > best
            best[better], number[better] = found[better], i
        return self._peaks(best, number, heights, count)

    def _peaks(
        self, best: NDArray[np.float32], number: NDArray[np.int64], heights: HeightMap, count: int
    ) -> NDArray[np.float64]:
        peak = (best >= cv2.dilate(best, np.ones((5, 5), np.uint8))) & (best > _LEAST)
        rows, columns = np.nonzero(peak)
        order = np.argsort(-best[rows, columns])[:count]
        rows, columns = rows[order], columns[order]
        middle = 0.5 * (_SHRINK - 1)
        pixels = np.stack([columns, rows], -1).astype(np.float64) * _SHRINK + middle
        places = heights.view.unproject(pixels)
        return np.column_stack([places, self._yaws[number[rows, columns]]])


def _kernel(
    item: PushedObject, yaw: float, cell: float
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """The outline's inside, and a border around it, in the map's axes; each sums up to 1."""
    half = math.ceil(item.radius / cell) + _RING + 1
    fine = 8  # points of a cell's side
    canvas = np.zeros(((2 * half + 1) * fine,) * 2, np.uint8)
    cos, sin = math.cos(yaw), math.sin(yaw)
    for outline in item.footprints():
        x, y = cos * outline[:, 0] - sin * outline[:, 1], sin * outline[:, 0] + cos * outline[:, 1]
        # Up in the map is +x, left +y.
        corners = np.stack([half - y / cell, half - x / cell], -1) * fine + 0.5 * (fine - 1)
        cv2.fillPoly(canvas, [np.rint(corners).astype(np.int32)], 1)
    share = cv2.resize(canvas.astype(np.float32), (2 * half + 1,) * 2, interpolation=cv2.INTER_AREA)
    wide = cv2.dilate(share, np.ones((2 * _RING + 1,) * 2, np.uint8))
    return share / share.sum(), (wide - share) / (wide - share).sum()
