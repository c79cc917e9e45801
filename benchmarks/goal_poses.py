"""An agent for goal poses on the sets of the eight scenes and of other objects, or on tuning episodes.

    python benchmarks/goal_poses.py pose --out runs/goal_poses
    python benchmarks/goal_poses.py pose --tuning --out runs/tuning

Prints success at 1.5 cm and each tolerance of the yaw, success without a contact of object, tool or arm
with an obstacle, the shares of episodes in which they touch one or leave the workspace, and the steps of
the solved ones, and the same for each object and each kind of obstacle of the sets of several objects.
The episodes are run once, at the smallest tolerance: at a wider one an episode ends at its first step
within that.

The tuning episodes are those with the numbers 2,000 to 2,099 of the generators of the seven sets with
obstacles and the box, and the set `tuning/pose/objects`. Settings are chosen on them.
`--set contact_filter False` changes a field of the agent's config.
"""

import argparse
import ast
import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from modpush import load_agent
from modpush.envs.outcome import pose_errors
from modpush.envs.scenes.objects import get_object
from modpush.envs.scenes.scenario import Scenario
from modpush.envs.scenes.shape_layouts import SHAPE_SCENES
from modpush.evaluation import (
    TUNING_SETS,
    EvaluationConfig,
    EvaluationSet,
    Trajectory,
    evaluate,
    format_table,
    generate_set,
    load_set,
)

_BOX_SETS = tuple(f"pose/{scene}/box" for scene in SHAPE_SCENES)
_TUNING = range(2000, 2100)
_SETS = (*_BOX_SETS, "pose/free/box", "pose/objects", "pose/unseen_objects")
_TUNING_SETS = (*_BOX_SETS, "tuning/pose/objects")


def chosen_set(name: str, degrees: float, episodes: int, tuning: bool) -> EvaluationSet:
    """The first episodes of a set, or those for tuning, at a tolerance of the yaw.

    More than the set holds are drawn as its own are.
    """
    if name in TUNING_SETS:
        found = load_set(name)
    elif tuning:
        found = generate_set(name, _TUNING)
    elif episodes > _TUNING.start:
        raise ValueError(
            f"goal_poses: episodes must be <= {_TUNING.start}, where tuning begins, got {episodes}."
        )
    else:
        found = load_set(name)
        more = episodes > len(found)
        found = generate_set(name, range(episodes)) if more else found.first(episodes)
    conditions = replace(found.conditions, yaw_tolerance=math.radians(degrees))
    return replace(found, name=f"{name}/{degrees:g}deg", conditions=conditions)


def row(
    scenario: Scenario, trajectory: Trajectory, degrees: float, tolerance: float
) -> dict[str, float]:
    """The figures of an episode that ends at its first step within the tolerances."""
    poses = trajectory.object_pose[1:].astype(np.float64)
    goal = np.array([*scenario.goal_position, scenario.goal_yaw])
    symmetry = np.full(len(poses), get_object(scenario.pushed_object).symmetry)
    distance, turn = pose_errors(poses, np.broadcast_to(goal, poses.shape), symmetry).T
    arrived = np.flatnonzero((distance <= tolerance) & (np.abs(turn) <= math.radians(degrees)))
    steps = int(arrived[0]) + 1 if len(arrived) else len(poses)
    _, thing, tool = trajectory.contacts[:steps].any(0)
    return {
        "success": float(len(arrived) > 0),
        "without contact": float(len(arrived) > 0 and not thing and not tool),
        "object touches": float(thing),
        "tool touches": float(tool),
        "ends early": float(len(arrived) == 0 and steps < 200),  # out of bounds
        "steps": steps if len(arrived) else math.nan,
    }


def main(
    agent: str,
    degrees: Sequence[float],
    episodes: int,
    tuning: bool,
    out: Path,
    changes: Sequence[Sequence[str]],
    sets: Sequence[str] | None,
) -> pd.DataFrame:
    """Run the agent, and print a table with a line for each set and tolerance."""
    loaded = load_agent(agent)
    fields: dict[str, Any] = {name: ast.literal_eval(value) for name, value in changes}
    loaded = replace(loaded, config=loaded.config.with_fields(**fields))
    lines = []
    for name in sets or (_TUNING_SETS if tuning else _SETS):
        chosen = chosen_set(name, min(degrees), episodes, tuning)
        folder = out / Path(agent).stem / chosen.name
        found = evaluate(loaded, chosen, folder, config=EvaluationConfig(progress=False))
        tolerance = chosen.conditions.position_tolerance
        runs = [Trajectory.load(folder / f"trajectories/{k:05d}.npz") for k in range(len(chosen))]
        for angle in degrees:
            rows = pd.DataFrame(
                [row(*episode, angle, tolerance) for episode in zip(chosen, runs, strict=True)]
            )
            assert angle > min(degrees) or rows["success"].sum() == found["success"].sum()
            lines.append({"set": name, "degrees": angle, **rows.mean()})
            print(
                {k: v if isinstance(v, str) else round(float(v), 3) for k, v in lines[-1].items()}
            )
            if len(chosen.objects) > 1:
                rows["object"] = [scenario.pushed_object for scenario in chosen]
                rows["scene"] = [scenario.scene for scenario in chosen]
                for kind in ("object", "scene"):
                    print(rows.groupby(kind).mean(numeric_only=True).round(3).to_string())
    table = pd.DataFrame(lines)
    print(format_table(table.set_index("set")))
    return table


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("agent", help="a shipped agent's name, or an agent's file")
    parser.add_argument(
        "--degrees", type=float, nargs="+", default=[30.0, 10.0], help="tolerances of the yaw"
    )
    parser.add_argument(
        "--episodes", type=int, default=100, help="of each set; tuning sets are whole"
    )
    parser.add_argument("--tuning", action="store_true", help="the tuning episodes instead")
    parser.add_argument("--out", type=Path, default=Path("runs/goal_poses"))
    parser.add_argument("--sets", nargs="+", help="names of sets with goal poses; default: all")
    parser.add_argument(
        "--set", nargs=2, action="append", default=[], dest="changes", metavar=("FIELD", "VALUE")
    )
    main(**vars(parser.parse_args()))
