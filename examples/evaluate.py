"""Evaluate policies on the evaluation sets: tables beside the paper's, pictures of what failed, videos.

    python examples/evaluate.py --policy corridor --set obstacles/small_cube
    python examples/evaluate.py --policy agent corridor --set all --episodes 100
    python examples/evaluate.py --policy runs/train_cpu --set free/small_cube
    python examples/evaluate.py --policy corridor --set smoke        # half a minute

For each policy and set `runs/evaluate/<policy>/<set>/` gets `episodes.csv` (a row an episode),
`table.md`, `.tex` and `.csv`, `failures.png`, `successes.png` and a video for each family. With
several policies `runs/evaluate/comparison/<set>.md` has metrics over the episodes that all solved,
and paired t-tests. An interrupted run goes on where it stopped; `--fresh` starts over.
"""

import functools
import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import pandas as pd
import torch
import tyro
from methods import Method, get_method

from modpush.evaluation.pictures import (
    contact_sheet,
    draw_episode,
    draw_frames,
    write_picture,
    write_video,
)
from modpush.evaluation.published_results import beside_paper
from modpush.evaluation.results import load_trajectory
from modpush.evaluation.runner import EvaluationConfig, evaluate
from modpush.evaluation.sets import SET_NAMES, EvaluationSet, load_set
from modpush.evaluation.tables import compare, format_table, summarize, to_display


@dataclass(frozen=True, kw_only=True)
class EvaluateConfig:
    """Policies, evaluation sets and what to write."""

    policy: tuple[str, ...] = ("corridor",)
    """Policies to evaluate: `corridor`, `corridor_faithful`, `scripted`, `agent` (the one that is
    shipped for the set's object, or the small cube's where there is none, which the output says), a
    training run's folder, or an agent's file. Several are compared with each other."""
    sets: Annotated[tuple[str, ...], tyro.conf.arg(name="set")] = ("smoke",)
    """Evaluation sets, or `all` for those of the paper."""
    episodes: int | None = None
    """Number of episodes to run of each set, from its first on; all by default."""
    num_envs: int = 8
    """Number of scenes that a process steps together."""
    workers: int = 1
    """Number of processes."""
    pictures: int = 24
    """Largest number of failed episodes that are drawn; half as many solved ones are."""
    videos: bool = True
    """Whether to write a video for each family."""
    fresh: bool = False
    """Start over instead of resuming an interrupted run."""
    out: Path = Path("runs/evaluate")
    """Folder to write to."""

    @property
    def set_names(self) -> tuple[str, ...]:
        """The sets asked for, `all` spelled out."""
        return tuple(n for n in SET_NAMES if n != "smoke") if "all" in self.sets else self.sets


def run(method: Method, evaluation_set: EvaluationSet, config: EvaluateConfig) -> pd.DataFrame:
    """One policy on one set: results, tables, pictures."""
    folder = config.out / method.name / evaluation_set.name
    rows = evaluate(
        method.make_policy(),
        evaluation_set,
        folder,
        make_env=method.make_env,
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
    print(f"\n{method.name} on {evaluation_set.name}\n\n{format_table(to_display(table))}")
    draw(rows, evaluation_set, folder, method.name, config)
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
        methods = [get_method(policy, episodes.objects) for policy in config.policy]
        rows = {method.name: run(method, episodes, config) for method in methods}
        report(name, rows, config)
    print(f"Wrote tables, per-episode data, pictures and videos to {config.out}/.")


if __name__ == "__main__":
    warnings.filterwarnings("ignore", message="Failed to find system libvulkan")
    main(tyro.cli(EvaluateConfig, description=__doc__))
