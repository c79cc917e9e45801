"""What is in the sets: distances, free straight lines, and the yardsticks' lengths.

python -m modpush.evaluation.set_statistics          # all sets; a table in Markdown
python -m modpush.evaluation.set_statistics hard/small_cube
"""

import argparse
import math

import numpy as np
import pandas as pd

from modpush._arguments import checked_arguments
from modpush.evaluation.authors_paths import authors_agent_length, authors_controller_length
from modpush.evaluation.sets import SET_NAMES, EvaluationSet, load_set
from modpush.evaluation.shortest import shortest_path
from modpush.evaluation.tables import format_table

__all__ = ["set_statistics"]


@checked_arguments
def set_statistics(episodes: EvaluationSet) -> dict[str, float]:
    """Means over the episodes of a set.

    Returns:
        `episodes`; `distance`, the mean distance from start to goal [m]; `under_0.3`, the share of
        those under 0.3 m; `straight`, the share of the episodes in which the straight line is free
        on the set's map; `shortest_length` [m]; and the mean ratios of the lengths by which the
        authors measured, `authors_agent` and `authors_controller`, to the shortest.
    """
    distance, straight, shortest, agent, controller = [], [], [], [], []
    for scenario in episodes:
        corners, length = shortest_path(scenario, inflation=episodes.conditions.inflation)
        distance.append(math.dist(scenario.object_pose[:2], scenario.goal_position))
        straight.append(len(corners) == 2)
        shortest.append(length)
        agent.append(authors_agent_length(scenario) / length)
        controller.append(authors_controller_length(scenario) / length)
    return {
        "episodes": len(episodes),
        "distance": float(np.mean(distance)),
        "under_0.3": float(np.mean(np.less(distance, 0.3))),
        "straight": float(np.mean(straight)),
        "shortest_length": float(np.mean(shortest)),
        "authors_agent": float(np.mean(agent)),
        "authors_controller": float(np.mean(controller)),
    }


def main() -> None:
    """Print the statistics of some sets, by default of all."""
    parser = argparse.ArgumentParser(description="Statistics of the evaluation sets.")
    parser.add_argument("sets", nargs="*", default=SET_NAMES, help="names of sets, all by default")
    table = {name: set_statistics(load_set(name)) for name in parser.parse_args().sets}
    print(format_table(pd.DataFrame(table).T.rename_axis("set")))


if __name__ == "__main__":
    main()
