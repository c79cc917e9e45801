"""How near agents come to a goal position: success on first parts of sets at several tolerances.

python benchmarks/tolerances.py
python benchmarks/tolerances.py --policy runs/train --sets free/small_cube --episodes 200
"""

import argparse
import tempfile
from dataclasses import replace
from pathlib import Path

from modpush.evaluation import EvaluationConfig, evaluate, load_set
from modpush.recipes import get_method


def main() -> None:
    """Print a table in Markdown."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--policy", nargs="+", default=["any_object", "small_cube"])
    parser.add_argument("--sets", nargs="+", default=["free/small_cube", "obstacles/small_cube"])
    parser.add_argument("--tolerances", nargs="+", type=float, default=[0.05, 0.03, 0.015, 0.01])
    parser.add_argument("--episodes", type=int, default=60)
    args = parser.parse_args()
    config = EvaluationConfig(progress=False)
    print("| policy | set | " + " | ".join(f"{100 * t:g} cm" for t in args.tolerances) + " |")
    print("|" + "---|" * (2 + len(args.tolerances)), flush=True)
    for policy in args.policy:
        for name in args.sets:
            cells = []
            for tolerance in args.tolerances:
                whole = load_set(name)
                conditions = replace(whole.conditions, position_tolerance=tolerance)
                episodes = replace(whole, name="tolerance", conditions=conditions, digest="")
                with tempfile.TemporaryDirectory() as folder:
                    first = episodes.first(args.episodes)
                    rows = evaluate(get_method(policy), first, Path(folder), config=config)
                steps = rows.loc[rows["success"], "steps"].mean()
                cells.append(f"{rows['success'].mean():.3f}, {steps:.1f}")
            print(f"| `{policy}` | `{name}` | " + " | ".join(cells) + " |", flush=True)


if __name__ == "__main__":
    main()
