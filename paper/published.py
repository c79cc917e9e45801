"""The results that the paper printed, for comparison with ours."""

from collections.abc import Mapping
from dataclasses import dataclass

__all__ = [
    "AGENT",
    "AGENT_RETRAINED",
    "CONTROLLER",
    "PAPER",
    "PrintedRow",
    "measured_as",
    "paper_set",
    "printed_rows",
]

AGENT, CONTROLLER = "paper: agent", "paper: controller"
AGENT_RETRAINED = f"{AGENT}, retrained"
"""Names of the rows: the paper's learned agent, Krivic and Piater's controller, and the agent after
further training on the object."""


@dataclass(frozen=True, kw_only=True)
class PrintedRow:
    """A row of one of the paper's tables."""

    name: str
    """The method: `AGENT`, `CONTROLLER` or `AGENT_RETRAINED`."""
    episodes: int
    """Number of episodes."""
    figures: Mapping[str, float]
    """Means by metric, lengths in metres. SPL is by the shortest path of a method's own planner, but in
    free space of both by that of Lazy Theta*."""
    stds: Mapping[str, float]
    """Standard deviations of those metrics that the paper prints them of."""


_COLUMNS = (
    "success",
    "contact_rate",
    "contact_rate_std",
    "collision_rate",
    "collision_rate_std",
    "spl",
    "path_length",
    "path_length_std",
)
_METHODS = {"agent": AGENT, "controller": CONTROLLER, "retrained": AGENT_RETRAINED}
_TABLES = """
free/small_cube          agent        500  1.000  0.943   0.13      -      -  0.928  0.429   0.11
free/small_cube          controller   500  0.998  0.870   0.15      -      -  0.918  0.430   0.10
obstacles/small_cube     agent       1000  0.980  0.995   0.02  0.008   0.04  0.910  0.523   0.18
obstacles/small_cube     controller  1000  0.955  0.850   0.10  0.011   0.05  0.952  0.513   0.16
obstacles/large_cube     agent       1000  0.977  0.995   0.02  0.007   0.04  0.910  0.520   0.18
obstacles/large_cube     controller  1000  0.957  0.851   0.10  0.012   0.05  0.954  0.510   0.16
obstacles/small_cylinder agent       1000  0.967  0.981   0.05  0.021   0.06  0.839  0.553   0.19
obstacles/small_cylinder controller  1000  0.945  0.889   0.11  0.014   0.04  0.940  0.512   0.17
obstacles/fragment       agent       1000  0.867  0.980   0.05  0.050   0.11  0.710  0.630   0.29
obstacles/fragment       controller  1000  0.953  0.868   0.11  0.024   0.07  0.951  0.501   0.16
obstacles/fragment       retrained   1000  0.959  0.984   0.05  0.010   0.05  0.830  0.580   0.23
hard/small_cube          agent         50  0.880  0.977   0.06  0.065   0.13  0.779  0.492   0.13
hard/small_cube          controller    50  0.720  0.566   0.11  0.010   0.05  0.720  0.550   0.18
"""
"""Set, method, number of episodes, and the figures of `_COLUMNS`."""


def _read_tables() -> dict[str, tuple[PrintedRow, ...]]:
    found: dict[str, tuple[PrintedRow, ...]] = {}
    for line in _TABLES.strip().splitlines():
        name, method, episodes, *values = line.split()
        known = {c: float(v) for c, v in zip(_COLUMNS, values, strict=True) if v != "-"}
        row = PrintedRow(
            name=_METHODS[method],
            episodes=int(episodes),
            figures={c: v for c, v in known.items() if not c.endswith("_std")},
            stds={c.removesuffix("_std"): v for c, v in known.items() if c.endswith("_std")},
        )
        found[name] = (*found.get(name, ()), row)
    return found | {"hard200/small_cube": found["hard/small_cube"]}


PAPER = _read_tables()
"""The paper's results by evaluation set. Source: Tables II to IV (Sec. V). `hard200/small_cube` continues
`hard/small_cube` with further episodes of the same distribution."""


def paper_set(evaluation_set: str) -> str:
    """The name in `PAPER` of a set, whatever the start of its tool (`behind/`) and the tool (`+rod`)."""
    return evaluation_set.removeprefix("behind/").partition("+")[0]


def printed_rows(evaluation_set: str) -> tuple[PrintedRow, ...]:
    """The paper's rows beside which a set of ours stands; none where the paper has no such set."""
    return PAPER.get(paper_set(evaluation_set), ())


def measured_as(evaluation_set: str, *, of_controller: bool) -> dict[str, str]:
    """Our metric that is measured as the authors measured a printed one, by the paper's metric.

    Contact and collisions are those of the looks at the steps' ends. The agent's collisions are of the
    object alone, the controller's of object or arm. Among obstacles SPL is by the path of a method's own
    planner, in free space for both by that of Lazy Theta* (paper Sec. V-B).

    Args:
        evaluation_set: Name of the set.
        of_controller: Whether the printed figure is the controller's, not the agent's.
    """
    staircase = of_controller and not paper_set(evaluation_set).startswith("free/")
    return {
        "success": "success",
        "contact_rate": "contact_rate_at_end",
        "collision_rate": "collision_rate_at_end"
        if of_controller
        else "collision_rate_object_at_end",
        "spl": "spl_authors_controller" if staircase else "spl_authors_agent",
        "path_length": "path_length",
    }
