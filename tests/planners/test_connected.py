"""Whether two points are joined, against scipy's graph search and the planners."""

import numpy as np
import torch
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from modpush.planners.occupancy_map import are_connected


def maps(count: int, side: int = 24) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    generator = torch.Generator().manual_seed(0)
    density = torch.linspace(0.2, 0.6, count)[:, None, None]
    blocked = torch.rand(count, side, side, generator=generator) < density
    start, end = (torch.randint(0, side, (count, 2), generator=generator).float() for _ in range(2))
    return blocked, start, end


def components(blocked: np.ndarray) -> np.ndarray:
    """Number of each cell's component among the free cells, by scipy's graph search, `[H, W]`."""
    height, width = blocked.shape
    cells = np.arange(height * width).reshape(height, width)
    free = ~blocked
    across, down = free[:, 1:] & free[:, :-1], free[1:] & free[:-1]
    one = np.concatenate([cells[:, :-1][across], cells[:-1][down]])
    other = np.concatenate([cells[:, 1:][across], cells[1:][down]])
    graph = coo_array((np.ones(len(one)), (one, other)), shape=(cells.size, cells.size))
    return connected_components(graph, directed=False)[1].reshape(height, width)


def test_it_agrees_with_a_graph_search_from_free_cells() -> None:
    blocked, start, end = maps(300)
    rows = torch.arange(len(blocked))
    for point in (start, end):
        blocked[rows, point[:, 1].long(), point[:, 0].long()] = False
    found = are_connected(blocked, start, end)
    for i in range(len(blocked)):
        labels = components(blocked[i].numpy())
        (a, b), (c, d) = start[i].int().tolist(), end[i].int().tolist()
        assert found[i] == (labels[b, a] == labels[d, c])
    assert 50 < found.sum() < 250


def test_a_point_in_a_blocked_cell_goes_to_the_free_one_that_is_nearest() -> None:
    """A wall at u = 4. The cell (3, 7) is blocked as well: its neighbours are on the left."""
    blocked = torch.zeros(1, 9, 9, dtype=torch.bool)
    blocked[:, :, 4] = blocked[:, 7, 3] = True
    inside, left, right = (torch.tensor([point]) for point in ([3.0, 7.0], [0.0, 0.0], [8.0, 0.0]))
    for ends, joined in (((inside, left), True), ((inside, right), False)):
        assert are_connected(blocked, *ends).item() == joined
        assert are_connected(blocked, *ends[::-1]).item() == joined
