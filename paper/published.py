"""The results that the paper printed, for comparison with ours."""

from collections.abc import Mapping
from dataclasses import dataclass

__all__ = ["PAPER", "PaperFigures", "measured_as", "paper_set"]


@dataclass(frozen=True, kw_only=True)
class PaperFigures:
    """One set's results in the paper: of its learned agent, and of Krivic and Piater's controller.

    Means over episodes, and standard deviations of those metrics that it prints them of.
    """

    episodes: int
    """Number of episodes."""
    success: tuple[float, float]
    contact_rate: tuple[float, float]
    contact_rate_std: tuple[float, float]
    collision_rate: tuple[float, float] | None = None
    collision_rate_std: tuple[float, float] | None = None
    spl: tuple[float, float]
    """Each by the shortest path of its own planner, but in free space both by that of Lazy Theta*."""
    path_length: tuple[float, float]
    """[m]"""
    path_length_std: tuple[float, float]
    """[m]"""
    significant: tuple[str, ...]
    """Metrics whose difference is marked as significant at 0.05."""
    retrained: Mapping[str, float] | None = None
    """Results of the agent after further training on this object, by metric, where there are some."""


_HARD = PaperFigures(
    episodes=50,
    success=(0.88, 0.72),
    contact_rate=(0.977, 0.566),
    contact_rate_std=(0.06, 0.11),
    collision_rate=(0.065, 0.01),
    collision_rate_std=(0.13, 0.05),
    spl=(0.779, 0.720),
    path_length=(0.492, 0.550),
    path_length_std=(0.13, 0.18),
    significant=("contact_rate", "collision_rate"),
)

PAPER = {
    "free/small_cube": PaperFigures(
        episodes=500,
        success=(1.000, 0.998),
        contact_rate=(0.943, 0.870),
        contact_rate_std=(0.13, 0.15),
        spl=(0.928, 0.918),
        path_length=(0.429, 0.430),
        path_length_std=(0.11, 0.10),
        significant=("contact_rate",),
    ),
    "obstacles/small_cube": PaperFigures(
        episodes=1000,
        success=(0.980, 0.955),
        contact_rate=(0.995, 0.850),
        contact_rate_std=(0.02, 0.10),
        collision_rate=(0.008, 0.011),
        collision_rate_std=(0.04, 0.05),
        spl=(0.910, 0.952),
        path_length=(0.523, 0.513),
        path_length_std=(0.18, 0.16),
        significant=("contact_rate", "path_length"),
    ),
    "obstacles/large_cube": PaperFigures(
        episodes=1000,
        success=(0.977, 0.957),
        contact_rate=(0.995, 0.851),
        contact_rate_std=(0.02, 0.10),
        collision_rate=(0.007, 0.012),
        collision_rate_std=(0.04, 0.05),
        spl=(0.910, 0.954),
        path_length=(0.520, 0.510),
        path_length_std=(0.18, 0.16),
        significant=("contact_rate", "collision_rate", "path_length"),
    ),
    "obstacles/small_cylinder": PaperFigures(
        episodes=1000,
        success=(0.967, 0.945),
        contact_rate=(0.981, 0.889),
        contact_rate_std=(0.05, 0.11),
        collision_rate=(0.021, 0.014),
        collision_rate_std=(0.06, 0.04),
        spl=(0.839, 0.940),
        path_length=(0.553, 0.512),
        path_length_std=(0.19, 0.17),
        significant=("contact_rate", "collision_rate", "path_length"),
    ),
    "obstacles/fragment": PaperFigures(
        episodes=1000,
        success=(0.867, 0.953),
        contact_rate=(0.980, 0.868),
        contact_rate_std=(0.05, 0.11),
        collision_rate=(0.05, 0.024),
        collision_rate_std=(0.11, 0.07),
        spl=(0.71, 0.951),
        path_length=(0.630, 0.501),
        path_length_std=(0.29, 0.16),
        significant=("contact_rate", "collision_rate", "path_length"),
        retrained={
            "success": 0.959,
            "contact_rate": 0.984,
            "contact_rate_std": 0.05,
            "collision_rate": 0.01,
            "collision_rate_std": 0.05,
            "spl": 0.83,
            "path_length": 0.58,
            "path_length_std": 0.23,
        },
    ),
    "hard/small_cube": _HARD,
    "hard200/small_cube": _HARD,
}
"""The paper's results by evaluation set. Source: Tables II to IV (Sec. V). `hard200/small_cube` continues
`hard/small_cube` with further episodes of the same distribution."""


def paper_set(evaluation_set: str) -> str:
    """The name in `PAPER` of a set, whatever the start of its tool (`behind/`) and the tool (`+rod`)."""
    return evaluation_set.removeprefix("behind/").partition("+")[0]


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
