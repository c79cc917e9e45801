"""A binary heap of node numbers with changeable keys, for numba kernels.

The heap is three arrays of the caller: `order` `[N]` int32 holds the node numbers as a heap, `key`
`[N]` float64 the key of each node, `slot` `[N]` int32 where in `order` a node stands, -1 if it does
not. The caller keeps the number of nodes in it.
"""

from numpy.typing import NDArray

from modpush._kernels import njit


@njit(nogil=True)
def _sift_up(order: NDArray, key: NDArray, slot: NDArray, at: int) -> None:
    node = order[at]
    value = key[node]
    while at > 0:
        above = (at - 1) >> 1
        other = order[above]
        if key[other] <= value:
            break
        order[at] = other
        slot[other] = at
        at = above
    order[at] = node
    slot[node] = at


@njit(nogil=True)
def heap_set(
    order: NDArray, key: NDArray, slot: NDArray, size: int, node: int, value: float
) -> int:
    """Insert a node, or lower its key; returns the new number of nodes in the heap."""
    key[node] = value
    at = slot[node]
    if at < 0:
        at = size
        order[at] = node
        size += 1
    _sift_up(order, key, slot, at)
    return size


@njit(nogil=True)
def heap_pop(order: NDArray, key: NDArray, slot: NDArray, size: int) -> int:
    """Take out the node with the smallest key, `order[0]`; returns it. The size falls by one."""
    top = order[0]
    slot[top] = -1
    size -= 1
    if size == 0:
        return top
    node = order[size]
    value = key[node]
    at = 0
    while True:
        below = 2 * at + 1
        if below >= size:
            break
        if below + 1 < size and key[order[below + 1]] < key[order[below]]:
            below += 1
        other = order[below]
        if key[other] >= value:
            break
        order[at] = other
        slot[other] = at
        at = below
    order[at] = node
    slot[node] = at
    return top
