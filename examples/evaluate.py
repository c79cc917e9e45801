"""Judge policies on the evaluation sets: tables beside the paper's, pictures of what failed, videos.

    python examples/evaluate.py --policy corridor --set obstacles/small_cube
    python examples/evaluate.py --policy corridor scripted --set all --episodes 100
    python examples/evaluate.py --policy corridor --set smoke        # half a minute

For each policy and set `runs/evaluate/<policy>/<set>/` gets `episodes.csv` (a row an episode),
`table.md`, `.tex` and `.csv`, `failures.png`, `successes.png` and a video for each family. With
several policies `runs/evaluate/comparison/<set>.md` has metrics over the episodes that all solved,
and paired t-tests. An interrupted run goes on where it stopped; `--fresh` starts over.
"""

import functools
import warnings
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import pandas as pd
import torch
import tyro
from tensordict.nn import TensorDictModuleBase
from torchrl.envs import Compose, EnvBase, InitTracker, TransformedEnv

from modpush.agents import PushingCorridorController, ScriptedPusher, faithful_config
from modpush.envs import PushEnv
from modpush.evaluation.paper import beside_paper
from modpush.evaluation.pictures import (
    contact_sheet,
    draw_episode,
    draw_frames,
    write_picture,
    write_video,
)
from modpush.evaluation.results import load_trajectory
from modpush.evaluation.runner import EvaluationConfig, evaluate
from modpush.evaluation.sets import SET_NAMES, EvaluationSet, load_set
from modpush.evaluation.tables import compare, format_table, summarize, to_display
from modpush.planners import DistanceField, OccupancyGrid, PlannerSubgoals


def make_env(num_envs: int, objects: Sequence[str], *, planner: bool, **options: Any) -> EnvBase:
    """`PushEnv`, with the planner's sub-goals for those that follow them."""
    transforms: list[Any] = [InitTracker()]
    if planner:
        transforms += [
            OccupancyGrid(object_radius_key="object_radius"),
            PlannerSubgoals(DistanceField(), max_waypoints=32),
        ]
    env = PushEnv(num_envs, pushed_object=tuple(objects), **options)
    return TransformedEnv(env, Compose(*transforms))


PolicyName = Literal["corridor", "corridor_faithful", "scripted"]


@dataclass(frozen=True, kw_only=True)
class Method:
    """A policy, the environment that it needs, and where to find what it plans."""

    make_policy: Callable[[], TensorDictModuleBase]
    make_env: Callable[..., EnvBase]
    path_key: Any
    target_key: Any


def _corridor(make_policy: Callable[[], TensorDictModuleBase]) -> Method:
    return Method(
        make_policy=make_policy,
        make_env=functools.partial(make_env, planner=False),
        path_key=("next", "corridor", "path"),
        target_key=("next", "corridor", "target"),
    )


METHODS: dict[PolicyName, Method] = {
    "corridor": _corridor(PushingCorridorController),
    "corridor_faithful": _corridor(lambda: PushingCorridorController(faithful_config())),
    "scripted": Method(
        make_policy=lambda: ScriptedPusher(target_key="subgoal"),
        make_env=functools.partial(make_env, planner=True),
        path_key="path",
        target_key="subgoal",
    ),
}


@dataclass(frozen=True, kw_only=True)
class EvaluateConfig:
    """What to judge, and on what."""

    policy: tuple[PolicyName, ...] = ("corridor",)
    """Several are compared with each other."""
    sets: Annotated[tuple[str, ...], tyro.conf.arg(name="set")] = ("smoke",)
    """Evaluation sets, or `all` for those of the paper."""
    episodes: int | None = None
    """Only the first so many of each set."""
    num_envs: int = 8
    """Scenes stepped together in a process."""
    workers: int = 1
    """Processes."""
    pictures: int = 24
    """At most so many failures, and half as many successes, are drawn."""
    videos: bool = True
    """A video for each family."""
    fresh: bool = False
    """Start over instead of going on."""
    out: Path = Path("runs/evaluate")
    """Folder to write to."""

    @property
    def set_names(self) -> tuple[str, ...]:
        """The sets asked for, `all` spelled out."""
        return tuple(n for n in SET_NAMES if n != "smoke") if "all" in self.sets else self.sets


def run(policy: PolicyName, evaluation_set: EvaluationSet, config: EvaluateConfig) -> pd.DataFrame:
    """One policy on one set: results, tables, pictures."""
    method = METHODS[policy]
    module = method.make_policy()
    folder = config.out / policy / evaluation_set.name
    settings = asdict(module.config) if hasattr(module, "config") else {}
    rows = evaluate(
        method.make_env,
        module,
        evaluation_set,
        folder,
        label=f"{policy} {settings}",
        config=EvaluationConfig(
            num_envs=config.num_envs,
            workers=config.workers,
            path_key=method.path_key,
            target_key=method.target_key,
        ),
        resume=not config.fresh,
    )
    by_scene = {str(scene): frame for scene, frame in rows.groupby("scene", sort=False)}
    table = pd.concat(
        [summarize({name: frame}) for name, frame in [("all", rows), *by_scene.items()]]
    ).rename_axis("scene")
    (folder / "table.csv").write_text(format_table(table, "csv"))
    (folder / "table.tex").write_text(format_table(to_display(table), "latex"))
    (folder / "table.md").write_text(format_table(to_display(table)))
    print(f"\n{policy} on {evaluation_set.name}\n\n{format_table(to_display(table))}")
    draw(rows, evaluation_set, folder, policy, config)
    return rows


def draw(
    rows: pd.DataFrame, episodes: EvaluationSet, folder: Path, policy: str, config: EvaluateConfig
) -> None:
    """Contact sheets of failures and successes, spread over the set, and a video a family."""
    load = functools.partial(load_trajectory, folder)
    for name, solved, most in (
        ("failures", False, config.pictures),
        ("successes", True, config.pictures // 2),
    ):
        chosen = rows[rows["success"] == solved]
        chosen = chosen.iloc[:: max(1, len(chosen) // max(1, most))].head(most)
        path = folder / f"{name}.png"
        path.unlink(missing_ok=True)
        pictures = [
            draw_episode(
                episodes.scenarios[row.episode],
                load(row.episode),
                caption=f"{row.episode} {row.scene}: {'solved' if solved else 'failed'}, "
                f"{row.steps} steps{', out of bounds' if row.out_of_bounds else ''}",
            )
            for row in chosen.itertuples()
        ]
        if pictures:
            write_picture(path, contact_sheet(pictures))
    for scene, frame in rows.groupby("scene") if config.videos else ():
        number = int(frame["episode"].iloc[0])
        frames = draw_frames(
            episodes.scenarios[number], load(number), caption=f"{policy}: {scene}, #{number}"
        )
        write_video(folder / "videos" / f"{scene}.mp4", frames)


def report(name: str, rows: dict[str, pd.DataFrame], config: EvaluateConfig) -> None:
    """Print policies beside the paper's figures; with several, test them against each other."""
    summary = summarize(rows)
    text = f"{name}: beside the paper\n\n{format_table(beside_paper(summary, name))}"
    if len(rows) > 1:
        text += f"\nmetrics over what all solved\n\n{format_table(to_display(summary))}"
        (first, a), *others = rows.items()
        for second, b in others:
            text += f"\n{first} against {second}\n\n{format_table(compare(a, b))}"
        path = config.out / "comparison" / f"{name}.md"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    else:
        (config.out / next(iter(rows)) / name / "beside_paper.md").write_text(text)
    print(f"\n{text}")


def main(config: EvaluateConfig) -> None:
    """Run every policy on every set."""
    # Kernels on 8 scenes are too short to share out: waiting for each other costs more.
    torch.set_num_threads(1)
    for name in config.set_names:
        episodes = load_set(name).first(config.episodes)
        rows = {str(policy): run(policy, episodes, config) for policy in config.policy}
        report(name, rows, config)
    print(f"Wrote tables, per-episode data, pictures and videos to {config.out}/.")


if __name__ == "__main__":
    warnings.filterwarnings("ignore", message="Failed to find system libvulkan")
    main(tyro.cli(EvaluateConfig, description=__doc__))
