"""Evaluate two policies on one evaluation set, and test which of them is better.

    python examples/evaluate.py                                # half a minute
    python examples/evaluate.py --set obstacles/small_cube     # 1000 episodes

Writes a folder for each policy in `runs/evaluate_two/`: a row for each episode, tables, pictures of what
failed and what was solved, and prints the figures with paired t-tests. A run that is
interrupted continues where it stopped. `modpush evaluate` does the same for any policies and sets.
"""

import argparse
import warnings
from pathlib import Path

import pandas as pd

from modpush.evaluation import (
    EvaluationConfig,
    EvaluationSet,
    comparison_report,
    draw_results,
    evaluate,
    load_set,
    write_tables,
)
from modpush.recipes import get_method


def evaluate_one(policy: str, episodes: EvaluationSet, folder: Path) -> pd.DataFrame:
    """One policy: a row for each episode."""
    method = get_method(policy)
    rows = evaluate(
        method.make_policy(),
        episodes,
        folder,
        make_env=method.make_env,
        config=EvaluationConfig(num_envs=8, path_key=method.path_key, target_key=method.target_key),
    )
    print(f"\n{policy}\n\n{write_tables(rows, folder)}")
    draw_results(rows, episodes, folder, policy, videos=False)
    return rows


def main(name: str, count: int | None, out: Path) -> dict[str, pd.DataFrame]:
    """Evaluate both, and compare them."""
    episodes = load_set(name).first(count)
    rows = {
        policy: evaluate_one(policy, episodes, out / policy / name)
        for policy in ("agent", "corridor")
    }
    print(name, comparison_report(rows))
    return rows


if __name__ == "__main__":
    warnings.filterwarnings("ignore", message="Failed to find system libvulkan")
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--set", default="smoke", help="evaluation set, see load_set")
    parser.add_argument("--episodes", type=int, help="number of episodes, all by default")
    parser.add_argument("--out", type=Path, default=Path("runs/evaluate_two"), help="folder")
    given = parser.parse_args()
    main(given.set, given.episodes, given.out)
