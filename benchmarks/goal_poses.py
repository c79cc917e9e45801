"""An agent for goal poses on the sets of the eight scenes, or on episodes that no set holds.

    python benchmarks/goal_poses.py pose --degrees 10 --out runs/goal_poses
    python benchmarks/goal_poses.py pose --tuning --degrees 10 --out runs/tuning

Prints success, success without a contact of object, tool or arm with an obstacle, the share of episodes
that leave the workspace, and the steps of the solved ones. The tuning episodes are those with the numbers
2,000 to 2,019 of the generators of the seven sets with obstacles, on which settings are chosen.
`--set contact_filter False` changes a field of the agent's config.
"""

import argparse
import ast
import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import pandas as pd

from modpush import load_agent
from modpush.envs.scenes.shape_layouts import SHAPE_SCENES
from modpush.evaluation import (
    EvaluationConfig,
    EvaluationSet,
    evaluate,
    format_table,
    generate_set,
    load_set,
)

_SCENES = (*SHAPE_SCENES, "free")
_TUNING = range(2000, 2020)


def chosen_set(scene: str, degrees: float, episodes: int, tuning: bool) -> EvaluationSet:
    """The first episodes of a scene's set, or its tuning episodes, at a tolerance of the yaw."""
    name = f"pose/{scene}/box"
    found = generate_set(name, _TUNING) if tuning else load_set(name).first(episodes)
    conditions = replace(found.conditions, yaw_tolerance=math.radians(degrees))
    return replace(found, name=f"{name}/{degrees:g}deg", conditions=conditions)


def row(rows: pd.DataFrame) -> dict[str, float]:
    solved = rows["success"].astype(bool)
    touched = (rows["collision_rate_object"] > 0) | (rows["collision_rate_arm"] > 0)
    return {
        "episodes": len(rows),
        "success": solved.mean(),
        "without contact": (solved & ~touched).mean(),
        "object touched": (rows["collision_rate_object"] > 0).mean(),
        "tool touched": (rows["collision_rate_arm"] > 0).mean(),
        "out of bounds": rows["out_of_bounds"].mean(),
        "steps": rows["steps"][solved].mean(),
    }


def main(
    agent: str,
    degrees: float,
    episodes: int,
    tuning: bool,
    out: Path,
    changes: Sequence[Sequence[str]],
    scenes: Sequence[str],
) -> pd.DataFrame:
    """Run the agent, and print a line for each scene."""
    loaded = load_agent(agent)
    fields: dict[str, Any] = {name: ast.literal_eval(value) for name, value in changes}
    loaded = replace(loaded, config=loaded.config.with_fields(**fields))
    lines = {}
    for scene in scenes:
        if tuning and scene == "free":
            continue
        chosen = chosen_set(scene, degrees, episodes, tuning)
        folder = out / Path(agent).stem / chosen.name
        rows = evaluate(loaded, chosen, folder, config=EvaluationConfig(progress=False))
        lines[scene] = row(rows)
        print(scene, {name: round(value, 3) for name, value in lines[scene].items()}, flush=True)
    table = pd.DataFrame.from_dict(lines, orient="index")
    table.loc["mean"] = table.mean()
    print(format_table(table))
    return table


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("agent", help="a shipped agent's name, or an agent's file")
    parser.add_argument("--degrees", type=float, default=30.0, help="tolerance of the yaw")
    parser.add_argument("--episodes", type=int, default=100, help="of each set")
    parser.add_argument("--tuning", action="store_true", help="the tuning episodes instead")
    parser.add_argument("--out", type=Path, default=Path("runs/goal_poses"))
    parser.add_argument("--scenes", nargs="+", default=_SCENES, choices=_SCENES)
    parser.add_argument(
        "--set", nargs=2, action="append", default=[], dest="changes", metavar=("FIELD", "VALUE")
    )
    main(**vars(parser.parse_args()))
