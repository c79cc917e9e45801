"""Evaluate policies on the evaluation sets: tables, pictures, videos.

    modpush evaluate --policy corridor --set obstacles/small_cube
    modpush evaluate --policy agent corridor --set all --episodes 100
    modpush evaluate --policy runs/train --set free/small_cube
    modpush evaluate --policy corridor --set smoke        # half a minute
    modpush evaluate --policy corridor --set behind/hard/small_cube --tool rod
    modpush evaluate --policy any_object --set obstacles/small_cube --engine mujoco
    modpush evaluate --policy any_object --set obstacles/small_cube --robot ur10
    modpush evaluate --policy any_object --set hard/small_cube --recovery False

For each policy and set `runs/evaluate/<policy>/<set>/` gets `episodes.csv` (a row for each episode),
`table.md` and `.csv`, `failures.png`, `successes.png` and a video for each family. With
several policies `runs/evaluate/comparison/<set>.md` has metrics over the episodes that all solved,
and paired t-tests. An interrupted run continues where it stopped; `--fresh` starts over.

Options:
  --policy NAME ...  Policies to evaluate: agent (the shipped one for all objects), a shipped agent by
                     its name, corridor, corridor_faithful, scripted, a training run's folder, an
                     agent's file, module:name of your own policy, or http://host:port of one that
                     another process serves; by default agent. Several are compared with each other.
  --set NAME ...     Evaluation sets by name or file; all, for all sets in which the tool starts in any
                     direction from the object, except smoke and the tuning sets; or behind/all, for
                     those in which it starts straight behind the object; by default smoke.
  --robot NAME       Arm to use instead of the sets' own: ur5, ur10, ... or module:name. Episodes whose
                     start it does not reach are left out; results are stored under SET+ROBOT.
  --tool NAME        Tool to use instead of the sets' own: 2f85, rod, or module:name; results are stored
                     under SET+TOOL.
  --engine NAME      Physics engine to use instead of the sets' own, at its own rate: sapien, mujoco, or
                     module:name; results are stored under SET+ENGINE.
  --sensing {exact,noise,delay,noise_delay}
                     Conditions of an agent's observations and actions instead of the sets' own: noise of
                     the object's pose (up to 1.5 cm and 7.5 degrees), delay (actions 1 to 3 steps old,
                     observations 1 step), or both; results are stored under SET+NAME.
  --recovery {True,False}
                     Use StuckRecovery, which takes over when a policy has come to rest before the
                     goal, or do not; by default as an agent's config says, and False for
                     hand-written policies. Results of the other choice are stored under
                     POLICY+recovery or POLICY_without_recovery.
  --episodes N       Number of episodes of each set, starting with its first; by default all.
  --num-envs N       Number of scenes that each process steps together; by default 8.
  --workers N        Number of processes, or ray for all CPUs of a Ray cluster; by default 1.
  --pictures N       Maximum number of failed episodes to draw, and at most half as many solved ones;
                     by default 24.
  --no-videos        Write no video for each family.
  --fresh            Start over instead of resuming an interrupted run.
  --out FOLDER       Folder to write to; by default runs/evaluate.
  --allow MODULE ... Modules from which an agent's file or a set's may import its author's own parts.
"""

import itertools
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from modpush import evaluation, recipes  # these import their parts, and torch, on first use
from modpush._types import AtLeastOne, Count, FilePath, Name, NonNegativeInteger, Scenes, Several
from modpush._validation import checked
from modpush.envs.engines.base import find_engine
from modpush.envs.robot.named import find_robot, find_tool
from modpush.envs.scenes.conditions import SensingName

if TYPE_CHECKING:
    import pandas as pd


@checked
class EvaluateConfig:
    """Policies, evaluation sets and what to write, which this module's docstring explains as options."""

    policy: AtLeastOne[Name] = ("agent",)
    sets: Annotated[AtLeastOne[Name], tyro.conf.arg(name="set")] = ("smoke",)
    robot: Name | None = None
    tool: Name | None = None
    engine: Name | None = None
    sensing: SensingName | None = None
    recovery: bool | None = None
    episodes: Count | None = None
    num_envs: Scenes = 8
    workers: Count | Literal["ray"] = 1
    pictures: NonNegativeInteger = 24
    videos: bool = True
    fresh: bool = False
    allow: Several[Name] = ()
    out: FilePath = Path("runs/evaluate")

    @property
    def set_names(self) -> tuple[str, ...]:
        """The sets asked for, each once, `all` and `behind/all` spelled out."""
        from modpush.evaluation.sets import BEHIND_SETS, EVALUATION_SETS

        groups = {"all": EVALUATION_SETS, "behind/all": BEHIND_SETS}
        names = [groups.get(name, (name,)) for name in self.sets]
        return tuple(dict.fromkeys(itertools.chain.from_iterable(names)))


def evaluate_policies(config: EvaluateConfig) -> "dict[str, dict[str, pd.DataFrame]]":
    """Run every policy on every set, and write tables, pictures and videos.

    Returns:
        A row for each episode, by set and policy.

    Raises:
        ValueError: Before an episode is run: if a policy or a set is unknown, or two policies or two sets
            have the same name.
    """
    methods = recipes.get_methods(config.policy, allow=config.allow, recovery=config.recovery)
    results: dict[str, dict[str, pd.DataFrame]] = {}
    for name, episodes in _load_sets(config).items():
        rows = {method.name: _evaluate_one(method, episodes, config) for method in methods}
        results[name] = rows
        if len(rows) > 1:
            report = evaluation.comparison_report(rows)
            path = config.out / "comparison" / f"{episodes.name}.md"
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(report, encoding="utf-8")
            print(f"\n{episodes.name}: {report}")
    videos = ", videos" if config.videos else ""
    print(f"Wrote to {config.out}/: tables, a row for each episode, pictures{videos}.")
    return results


def _load_sets(config: EvaluateConfig) -> dict[str, "evaluation.EvaluationSet"]:
    """The chosen part of each set, by what the set was asked for as."""
    sets: dict[str, evaluation.EvaluationSet] = {}
    # A package that is missing is named before an episode is run.
    for given, find in (
        (config.robot, find_robot),
        (config.tool, find_tool),
        (config.engine, find_engine),
    ):
        if given is not None:
            find(given)
    for asked in config.set_names:
        episodes = evaluation.load_set(asked, allow=config.allow)
        episodes = episodes.with_conditions(
            robot=config.robot, tool=config.tool, engine=config.engine, sensing=config.sensing
        )
        if config.robot is not None:
            reached = episodes.within_reach()
            if len(reached) < len(episodes):
                print(
                    f"{episodes.name}: {len(reached)} of {len(episodes)} starts are within reach."
                )
            episodes = reached
        episodes = episodes.first(config.episodes)
        for other, known in sets.items():
            if known.name == episodes.name:
                raise ValueError(
                    f"set: {other!r} and {asked!r} are both called {episodes.name!r}, by which results "
                    "are kept; expected different names."
                )
        sets[asked] = episodes
    return sets


def _evaluate_one(
    method: "recipes.Method", evaluation_set: "evaluation.EvaluationSet", config: EvaluateConfig
) -> "pd.DataFrame":
    """One policy on one set."""
    folder = config.out / method.name / evaluation_set.name
    rows = evaluation.evaluate(
        method.make_policy(),
        evaluation_set,
        folder,
        make_env=method.make_env,
        config=evaluation.EvaluationConfig(
            num_envs=config.num_envs,
            workers=config.workers,
            path_key=method.path_key,
            target_key=method.target_key,
        ),
        resume=not config.fresh,
    )
    table = evaluation.write_tables(rows, folder)
    print(f"\n{method.name} on {evaluation_set.name}\n\n{table}")
    evaluation.draw_results(
        rows, evaluation_set, folder, method.name, pictures=config.pictures, videos=config.videos
    )
    return rows


def main(arguments: Sequence[str]) -> None:
    """`modpush evaluate <arguments>`."""
    config = tyro.cli(EvaluateConfig, prog="modpush evaluate", args=[*arguments])
    evaluate_policies(config)
