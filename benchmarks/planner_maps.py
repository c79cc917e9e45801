"""Maps to plan on, and the exact optimum from a visibility graph, for benchmarks and tests.

Nothing here is shared with the library: corners, lines of sight and shortest paths are computed in
another way (prefix sums over rows, in floating point, and scipy's Dijkstra).
"""

from collections.abc import Iterator

import cv2
import numpy as np
import scipy.ndimage as ndi
from numpy.typing import NDArray
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import dijkstra

from modpush._kernels import njit


def random_map(
    rng: np.random.Generator, boxes: int = 10, side: int = 256, radius: int = 10
) -> NDArray:
    """Rotated boxes, inflated by a disc with OpenCV."""
    image = np.zeros((side, side), np.uint8)
    for _ in range(boxes):
        centre, size, angle = rng.uniform(0, side, 2), rng.uniform(8, 60, 2), rng.uniform(0, 180)
        box = cv2.boxPoints((tuple(map(float, centre)), tuple(map(float, size)), float(angle)))
        cv2.fillPoly(image, [np.round(box).astype(np.int32)], 1)
    disc = np.hypot(*np.mgrid[-radius : radius + 1, -radius : radius + 1]) <= radius
    return cv2.dilate(image, disc.astype(np.uint8)).astype(bool)


def random_query(rng: np.random.Generator, blocked: NDArray) -> tuple[NDArray, NDArray]:
    """Two free cells (u, v) that are joined by free cells."""
    label, _ = ndi.label(~blocked)
    free = np.argwhere(~blocked)
    while True:
        start, goal = free[rng.integers(len(free), size=2)]
        if label[tuple(start)] == label[tuple(goal)] and (start != goal).any():
            return start[::-1].astype(np.float32), goal[::-1].astype(np.float32)


def solvable_maps(
    seed: int, count: int, **kwargs: int
) -> Iterator[tuple[NDArray, NDArray, NDArray]]:
    """`count` maps with a query each: (blocked `[H, W]`, start (u, v), goal (u, v))."""
    rng = np.random.default_rng(seed)
    for _ in range(count):
        blocked = random_map(rng, **kwargs)
        yield blocked, *random_query(rng, blocked)


@njit()
def _sees(padded, sums, x0, y0, x1, y1):
    """Line of sight in the vertex frame, row by row, in floating point.

    `padded` is the map with a blocked rim, so that cell (i, j) is `padded[j + 1, i + 1]`; `sums`
    holds running sums of its rows, so that a run of cells is asked about at once.
    """
    eps = 1e-9
    if y0 > y1:
        x0, y0, x1, y1 = x1, y1, x0, y0
    height, width = padded.shape[0] - 2, padded.shape[1] - 2
    if y1 - y0 < eps:
        low, high = min(x0, x1), max(x0, x1)
        whole = abs(y0 - np.round(y0)) < eps
        row = int(np.round(y0)) if whole else int(np.floor(y0))
        for i in range(width):
            if i + 1 <= low + eps or i >= high - eps:
                continue
            below = padded[row + 1, i + 1]
            if (not whole and below) or (whole and below and padded[row, i + 1]):
                return False
            if whole and i > low + eps:  # the free side may not change where two cells touch
                above = padded[row, i + 1]
                if (below and padded[row, i]) or (above and padded[row + 1, i]):
                    return False
        return True
    slope = (x1 - x0) / (y1 - y0)
    for j in range(height):
        if j + 1 <= y0 + eps or j >= y1 - eps:
            continue
        xa = x0 + (max(j, y0) - y0) * slope
        xb = x0 + (min(j + 1, y1) - y0) * slope
        low, high = min(xa, xb), max(xa, xb)
        if high - low < eps and abs(low - np.round(low)) < eps:
            c = int(np.round(low))
            if padded[j + 1, c] and padded[j + 1, c + 1]:
                return False
        else:
            first, last = int(np.floor(low + eps)), int(np.ceil(high - eps))
            if sums[j + 1, last + 1] - sums[j + 1, first + 1] > 0:
                return False
        if j > y0 + eps and abs(xa - np.round(xa)) < 1e-7:  # through a vertex
            c = int(np.round(xa))
            if (padded[j, c] and padded[j + 1, c + 1]) or (padded[j, c + 1] and padded[j + 1, c]):
                return False
    return True


@njit()
def _visible_pairs(padded, sums, nodes):
    count = len(nodes)
    weight = np.zeros((count, count))
    for a in range(count):
        for b in range(a + 1, count):
            if _sees(padded, sums, nodes[a, 0], nodes[a, 1], nodes[b, 0], nodes[b, 1]):
                weight[a, b] = np.hypot(nodes[a, 0] - nodes[b, 0], nodes[a, 1] - nodes[b, 1])
    return weight


def _map_sums(blocked: NDArray) -> tuple[NDArray, NDArray]:
    padded = np.pad(blocked, 1, constant_values=True)
    return padded, np.pad(padded.cumsum(1), ((0, 0), (1, 0)))


def visible(blocked: NDArray, start: NDArray, goal: NDArray) -> bool:
    """Whether two points (u, v) [px] see each other."""
    padded, sums = _map_sums(blocked)
    return _sees(padded, sums, *(np.asarray(start, float) + 0.5), *(np.asarray(goal, float) + 0.5))


def shortest_length(blocked: NDArray, start: NDArray, goal: NDArray) -> float:
    """Exact any-angle optimum between two free points (u, v), inf if there is none [px]."""
    around = np.pad(blocked, 1, constant_values=False).astype(int)
    count = around[:-1, :-1] + around[:-1, 1:] + around[1:, :-1] + around[1:, 1:]
    corners = np.argwhere(count == 1)[:, ::-1].astype(float)
    inside = ((corners > 0) & (corners < np.array(blocked.shape)[::-1])).all(1)
    ends = np.array([start, goal], dtype=float) + 0.5
    nodes = np.concatenate([corners[inside], ends])
    weight = _visible_pairs(*_map_sums(blocked), nodes)
    distance = dijkstra(csr_matrix(weight), directed=False, indices=len(nodes) - 2)
    return float(distance[-1])


def family_map(rng: np.random.Generator, family: str, radius: float = 9.93) -> NDArray:
    """One of the paper's scene families, drawn as rectangles [cells] and inflated."""
    side, image = 256, np.zeros((256, 256), np.uint8)
    thick, cell = 0.06 / 0.00356, 0.00356

    def bar(x: float, y: float, length: float, angle: float, width: float = thick) -> None:
        box = cv2.boxPoints(((x, y), (length, width), angle))
        cv2.fillPoly(image, [np.round(box).astype(np.int32)], 1)

    gap = rng.uniform(0.10, 0.20) / cell
    if family in ("bar_across", "bar_along"):
        base = 0 if family == "bar_across" else 90
        bar(128, 140, rng.uniform(0.1, 0.6) / cell, base + rng.uniform(-45, 45))
    elif family == "slot":
        for sign in (-1, 1):
            bar(128 + sign * (gap / 2 + 56), 140, 112, 0)
    elif family == "posts":
        for dx, dy in ((-1, -1), (-1, 1), (1, -1), (1, 1)):
            half = (gap + 0.05 / cell) / 2
            bar(128 + dx * half, 140 + dy * half, 0.05 / cell, 0, 0.05 / cell)
    else:
        for sign in (-1, 1):
            bar(128, 140 + sign * (gap + thick) / 2, 0.3 / cell, 0)
    reach = int(radius)
    disc = np.hypot(*np.mgrid[-reach : reach + 1, -reach : reach + 1]) <= radius
    return cv2.dilate(image, disc.astype(np.uint8))[:side, :side].astype(bool)


FAMILIES = ("bar_across", "bar_along", "slot", "posts", "corridor")


def family_maps(seed: int, count: int) -> Iterator[tuple[NDArray, NDArray, NDArray]]:
    """`count` maps in turn from each family, with a query each."""
    rng = np.random.default_rng(seed)
    for k in range(count):
        blocked = family_map(rng, FAMILIES[k % len(FAMILIES)])
        yield blocked, *random_query(rng, blocked)
