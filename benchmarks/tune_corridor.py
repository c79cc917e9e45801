"""The corridor controller's inversion threshold, compared on the tuning sets.

    python benchmarks/tune_corridor.py                       # thresholds 0.3, 0.4, 0.5, 0.6
    python benchmarks/tune_corridor.py --episodes 100

Writes a row for each episode to `runs/tune_corridor/<set>/<threshold>/` and prints, for each set,
success and SPL over all episodes, the other metrics over what all thresholds solved, and paired
t-tests against the default of `CorridorConfig`. An interrupted run goes on where it stopped.
"""

import argparse
import warnings
from pathlib import Path

import pandas as pd
import torch

from modpush.agents import CorridorConfig, PushingCorridorController
from modpush.evaluation import (
    TUNING_SETS,
    EvaluationConfig,
    compare,
    evaluate,
    format_table,
    load_set,
    summarize,
    to_display,
)
from modpush.recipes import get_method


def main(
    thresholds: list[float], sets: list[str], count: int | None, out: Path
) -> dict[str, dict[str, pd.DataFrame]]:
    """Run all thresholds on all sets, and print how they compare.

    Returns:
        A row for each episode, by set and threshold.
    """
    torch.set_num_threads(1)
    corridor = get_method("corridor")  # for its environment
    default = str(CorridorConfig().inversion)
    results: dict[str, dict[str, pd.DataFrame]] = {}
    for name in sets:
        episodes = load_set(name).first(count)
        results[name] = {
            str(threshold): evaluate(
                PushingCorridorController(CorridorConfig(inversion=threshold)),
                episodes,
                out / name / str(threshold),
                make_env=corridor.make_env,
                config=EvaluationConfig(path_key=corridor.path_key, target_key=corridor.target_key),
            )
            for threshold in thresholds
        }
        rows = results[name]
        print(f"\n{name}\n\n{format_table(to_display(summarize(rows)))}")
        for threshold in (t for t in rows if default in rows and t != default):
            tests = compare(rows[threshold], rows[default])
            print(f"\n{threshold} against {default}\n\n{format_table(tests)}")
    return results


if __name__ == "__main__":
    warnings.filterwarnings("ignore", message="Failed to find system libvulkan")
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--thresholds", type=float, nargs="+", default=[0.3, 0.4, 0.5, 0.6])
    parser.add_argument("--sets", nargs="+", default=list(TUNING_SETS), help="see load_set")
    parser.add_argument("--episodes", type=int, help="number of episodes, all by default")
    parser.add_argument("--out", type=Path, default=Path("runs/tune_corridor"), help="folder")
    given = parser.parse_args()
    main(given.thresholds, given.sets, given.episodes, given.out)
