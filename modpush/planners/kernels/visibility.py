"""Exact visibility among the blocked cells of a grid: vertices, line of sight, nearest free cell.

All any-angle planners use the kernels below. Coordinates are in the grid's *vertex frame*: cell (i, j)
covers the square [i, i+1] x [j, j+1], so that the cells' corners, at which shortest paths bend, have
integer coordinates. The vertex frame is the pixel frame (cell centres at integers) shifted by half a
cell. Points are in fixed point with `FRACTION_BITS` fractional bits, so that visibility is computed
in integers, without a tolerance: a line may touch a blocked cell's corner or run along its side, but
neither enter its interior nor pass between two blocked cells that meet in a point.
"""

import numpy as np
from numpy.typing import NDArray

from modpush._kernels import njit

# 16 bits hold every float32 pixel coordinate from 128 on exactly, and others to 8e-6 px; with grids
# of up to 4096 cells a side, products of two coordinates stay below 2^57.
FRACTION_BITS = 16
ONE = 1 << FRACTION_BITS
MAX_SIDE = 4096

# Bits of the blocked cells among the four at a vertex (y points down the image, as rows do).
NW, NE, SW, SE = 1, 2, 4, 8


@njit(nogil=True)
def vertex_codes(cells: NDArray, codes: NDArray) -> None:
    """Write the mask of blocked cells at each vertex; the outside counts as blocked.

    `cells` is `[H, W]` uint8, 1 where blocked; `codes` `[H + 1, W + 1]` uint8 gets sums of `NW`, `NE`,
    `SW`, `SE`.
    """
    height, width = cells.shape
    for y in range(height + 1):
        row = codes[y]
        if y == 0:
            row[:] = NW | NE
        else:
            above = cells[y - 1]
            row[0] = NW | (above[0] << 1)
            row[width] = above[width - 1] | NE
            for x in range(1, width):  # in uint8 throughout, so that it runs on vectors
                row[x] = above[x - 1] + np.uint8(2) * above[x]
        if y == height:
            for x in range(width + 1):
                row[x] |= SW | SE
        else:
            below = cells[y]
            row[0] |= SW | (below[0] << 3)
            row[width] |= (below[width - 1] << 2) | SE
            for x in range(1, width):
                row[x] += np.uint8(4) * below[x - 1] + np.uint8(8) * below[x]


@njit(nogil=True)
def convex_corners(codes: NDArray, corners: NDArray) -> int:
    """List the vertices with exactly one blocked cell, the only ones at which shortest paths bend.

    Rows (x, y, bx, by) are written to `corners` `[N, 4]` int64: the vertex in fixed point and the
    diagonal direction, each component -1 or 1, in which its blocked cell lies. Returns their number,
    also where it is more than N.
    """
    flat, width = codes.ravel(), codes.shape[1]
    words = flat[: flat.size // 8 * 8].view(np.uint64)
    count, y, row = 0, 0, 0
    for w in range(words.size + 1):
        if w < words.size:
            # Count each byte's bits, eight bytes at a time; a corner's byte has just one.
            bits = words[w]
            bits -= (bits >> np.uint64(1)) & np.uint64(0x5555555555555555)
            twos = np.uint64(0x3333333333333333)
            bits = (bits & twos) + ((bits >> np.uint64(2)) & twos)
            others = (bits ^ np.uint64(0x0101010101010101)) + np.uint64(0x7F7F7F7F7F7F7F7F)
            if others & np.uint64(0x8080808080808080) == np.uint64(0x8080808080808080):
                continue
        for at in range(8 * w, min(8 * w + 8, flat.size)):
            code = flat[at]
            if code == 0 or (code & (code - 1)) != 0:
                continue
            while at - row >= width:
                row += width
                y += 1
            if count < corners.shape[0]:
                corners[count, 0] = (at - row) << FRACTION_BITS
                corners[count, 1] = y << FRACTION_BITS
                corners[count, 2] = 1 if code & (NE | SE) else -1
                corners[count, 3] = 1 if code & (SW | SE) else -1
            count += 1
    return count


@njit(nogil=True)
def _visible_along(codes: NDArray, at: int, side: int, start: int, end: int) -> bool:
    """Line of sight along a row or column of `codes`, from `start` to `end`, all in fixed point.

    `at` is the line's place across it, and `side` the cell that meets `SE` at a line between cells.
    """
    first, last = start >> FRACTION_BITS, (end - 1) >> FRACTION_BITS
    inside = at & (ONE - 1) != 0  # through the inside of one row of cells: it must be free
    for k in range(first, last + 1):
        code = codes[k]
        if code & SE and (inside or code & side):  # between two rows: one side must be free
            return False
        if not inside and k > first and (code == (NW | SE) or code == (NE | SW)):
            return False
    return True


@njit(nogil=True)
def line_of_sight(codes: NDArray, x0: int, y0: int, x1: int, y1: int) -> bool:
    """True if a segment crosses no blocked cell's interior.

    Its points are in the vertex frame, fixed point; they themselves may lie on blocked cells' sides.
    """
    if y0 == y1:
        row = codes[y0 >> FRACTION_BITS]
        return x0 == x1 or _visible_along(row, y0, NE, min(x0, x1), max(x0, x1))
    if x0 == x1:
        column = codes[:, x0 >> FRACTION_BITS]
        return _visible_along(column, x0, SW, min(y0, y1), max(y0, y1))
    adx, ady = abs(x1 - x0), abs(y1 - y0)
    # The cell that the segment starts into, and how far away the next grid lines are.
    if x1 > x0:
        step_x, i = 1, x0 >> FRACTION_BITS
        to_x = ((i + 1) << FRACTION_BITS) - x0
    else:
        step_x, i = -1, (x0 - 1) >> FRACTION_BITS
        to_x = x0 - (i << FRACTION_BITS)
    if y1 > y0:
        step_y, j = 1, y0 >> FRACTION_BITS
        to_y = ((j + 1) << FRACTION_BITS) - y0
    else:
        step_y, j = -1, (y0 - 1) >> FRACTION_BITS
        to_y = y0 - (j << FRACTION_BITS)
    # Ways along the segment, times adx * ady so that they are whole numbers.
    next_x, next_y = to_x * ady, to_y * adx
    delta_x, delta_y = ady << FRACTION_BITS, adx << FRACTION_BITS
    end = adx * ady
    if codes[j, i] & SE:
        return False
    while True:
        if next_x < next_y:
            if next_x >= end:
                return True
            i += step_x
            next_x += delta_x
        elif next_y < next_x:
            if next_y >= end:
                return True
            j += step_y
            next_y += delta_y
        else:  # exactly through a vertex
            if next_x >= end:
                return True
            if codes[j, i + step_x] & SE and codes[j + step_y, i] & SE:
                return False
            i += step_x
            j += step_y
            next_x += delta_x
            next_y += delta_y
        if codes[j, i] & SE:
            return False


@njit(nogil=True)
def to_fixed(u: float, side: int) -> int:
    """Pixel coordinate to the vertex frame in fixed point, clamped to the grid's inside."""
    if u <= -0.5:
        return 1
    if u >= side - 0.5:
        return (side << FRACTION_BITS) - 1
    return min(max(int(np.rint((u + 0.5) * ONE)), 1), (side << FRACTION_BITS) - 1)


@njit(nogil=True)
def nearest_free_cell(codes: NDArray, x: int, y: int) -> tuple[int, int]:
    """Column and row of the free cell whose centre is nearest to a point of the vertex frame.

    (-1, -1) if all are blocked. Of cells as near as each other it is the first in reading order.
    """
    height, width = codes.shape[0] - 1, codes.shape[1] - 1
    ci, cj = x >> FRACTION_BITS, y >> FRACTION_BITS
    half = ONE >> 1
    best, best_i, best_j = 1 << 62, -1, -1
    for ring in range(max(height, width)):
        # A cell of this ring is at least ring - 1/2 away: nearer ones cannot follow.
        reach = (ring << FRACTION_BITS) - half
        if best_i >= 0 and reach > 0 and reach * reach > best:
            break
        for j in range(max(cj - ring, 0), min(cj + ring, height - 1) + 1):
            on_edge_row = abs(j - cj) == ring
            step = 1 if on_edge_row or ring == 0 else 2 * ring
            for i in range(ci - ring, ci + ring + 1, step):
                if i < 0 or i >= width or codes[j, i] & SE:
                    continue
                dx = (i << FRACTION_BITS) + half - x
                dy = (j << FRACTION_BITS) + half - y
                distance = dx * dx + dy * dy
                earlier = j < best_j or (j == best_j and i < best_i)
                if distance < best or (distance == best and earlier):
                    best, best_i, best_j = distance, i, j
    return best_i, best_j


@njit(nogil=True)
def place(codes: NDArray, u: float, v: float) -> tuple[int, int, bool]:
    """Move a query point (u, v) of the pixel frame into free space.

    A point outside the grid or in a blocked cell goes to the centre of the nearest free cell. A point on
    the line between cells is taken as lying in a free one of them, 2^-16 px inside, so that it has just
    one cell. Returns x and y in the vertex frame, fixed point, and True if the point had to be moved; x
    is -1 if no cell is free.
    """
    height, width = codes.shape[0] - 1, codes.shape[1] - 1
    x, y = to_fixed(u, width), to_fixed(v, height)
    outside = not (-0.5 <= u <= width - 0.5 and -0.5 <= v <= height - 0.5)
    if not outside:
        on_x, on_y = x & (ONE - 1) == 0, y & (ONE - 1) == 0
        for dy in (1, -1):
            for dx in (1, -1):
                px, py = x + (dx if on_x else 0), y + (dy if on_y else 0)
                if codes[py >> FRACTION_BITS, px >> FRACTION_BITS] & SE == 0:
                    return px, py, False
    i, j = nearest_free_cell(codes, x, y)
    if i < 0:
        return -1, -1, True
    half = ONE >> 1
    return (i << FRACTION_BITS) + half, (j << FRACTION_BITS) + half, True
