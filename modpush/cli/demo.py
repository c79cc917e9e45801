"""Watch a trained agent push different objects, beside the corridor controller.

Twelve scene families are shown, and four objects in turn. `--scenes` takes others as well, such as the
paper's hard ones, `diagonal_walls` and `maze`.

    modpush demo                                 # what `make demo` runs
    modpush demo --episodes 8 --scenes slot posts
    modpush demo --policy scripted               # a simpler pusher, along the planner's sub-goals
    modpush demo --goal pose                     # goals with orientation, past obstacles

Writes `runs/demo/`: `table.md`, one picture for each family and `demo.mp4`, top views of the same
episodes side by side, with the first planned path and the present sub-goal in magenta. Each says which
policy pushes which object, and how the episode ended. It also writes `arm.mp4`, the first policy's
episodes from the side: in MuJoCo everywhere, in SAPIEN where there is a Vulkan device.

Options:
  --policy NAME ...         Policies to show side by side: agent, a shipped agent by its name, corridor,
                            corridor_faithful, scripted, a training run's folder, or an agent's file;
                            by default any_object and corridor, for poses pose.
  --scenes NAME ...         Scene families to show; by default twelve, for poses free space and the seven
                            with one obstacle, two, or one that moves.
  --episodes N              Number of episodes of each family; the first one is shown in the video; by
                            default 4.
  --pushed-object NAME ...  Objects that are pushed, one after the other; by default small_cube,
                            large_cube, small_cylinder and fragment, for poses box, fragment,
                            large_cube and small_cube.
  --difficulty X            Difficulty of the scenes, 0 to 1; by default 0.3.
  --goal {position,pose}    Positions of the object's centre as goals, or poses, at 1.5 cm and 10 degrees.
  --robot NAME              Arm: ur5, ur10, panda, ... or module:name; by default ur5.
  --tool NAME               Tool of the arm: 2f85, rod, or module:name; by default 2f85.
  --engine NAME             Physics engine: sapien, mujoco, or module:name; by default sapien.
  --seed N                  Seed of the episodes; by default 0.
  --no-rendered             Write no arm.mp4.
  --out FOLDER              Folder to write to; by default runs/demo.
  --allow MODULE ...        Modules from which an agent's file may import its author's own parts.
"""

import itertools
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import torch
import tyro
from numpy.typing import NDArray
from torchrl.envs import EnvBase
from tqdm import tqdm

from modpush._atomic import make_folder
from modpush._types import Count, FilePath, Fraction, Name, Seed, Several
from modpush._validation import checked
from modpush.envs import (
    SCENES,
    PushEnv,
    Scenario,
    ScenarioConfig,
    find_render_device,
    sample_scenario,
)
from modpush.envs.engines.base import find_engine
from modpush.envs.outcome import GOAL_THRESHOLD, Goal
from modpush.envs.robot.named import find_robot, find_tool
from modpush.envs.scenes.conditions import EpisodeConditions
from modpush.envs.scenes.layouts import TIGHT_SCENES
from modpush.envs.scenes.objects import PAPER_OBJECTS
from modpush.envs.scenes.shape_layouts import SHAPE_SCENES
from modpush.evaluation.episodes import Episode, run_episodes
from modpush.evaluation.report import (
    contact_sheet,
    draw_episode,
    join_clips,
    write_picture,
    write_video,
)
from modpush.evaluation.tables import format_table
from modpush.recipes.methods import Method, get_methods

_DISTANCE = (0.2, 0.35)
"""Distances from start to goal [m]: short enough for large objects in nearly all families."""

_POSE_DISTANCE = (0.35, 0.5)
"""Distances from start to goal pose, with room for an obstacle in the straight way [m]."""

_POSE_OBJECTS = ("box", "fragment", "large_cube", "small_cube")
"""Objects that are pushed to goal poses, of those that the shipped agent knows."""

_POSITION_TOLERANCE = 0.015
"""Distance from a goal pose at which an episode succeeds [m]."""

Frames = dict[int, list[NDArray[np.uint8]]]
"""Pictures by number of the episode."""


@checked
class DemoConfig:
    """Settings of the demo, which this module's docstring explains as options.

    Where `policy`, `scenes` and `pushed_object` are empty, they follow from `goal`.
    """

    policy: Several[Name] = ()
    scenes: Several[Name] = ()
    episodes: Count = 4
    pushed_object: Several[Name] = ()
    difficulty: Fraction = 0.3
    seed: Seed = 0
    goal: Goal = "position"
    robot: Name = "ur5"
    tool: Name = "2f85"
    engine: Name = "sapien"
    out: FilePath = Path("runs/demo")
    allow: Several[Name] = ()
    rendered: bool = True

    def filled(self) -> "DemoConfig":
        """The same with what is shown by default in place of what is empty."""
        poses = self.goal == "pose"
        return replace(
            self,
            policy=self.policy or (("pose",) if poses else ("any_object", "corridor")),
            scenes=self.scenes or (("free", *SHAPE_SCENES) if poses else tuple(SCENES)),
            pushed_object=self.pushed_object or (_POSE_OBJECTS if poses else PAPER_OBJECTS),
        )


def show_demo(config: DemoConfig) -> str:
    """Run the policies on the same episodes, and write table, pictures and videos.

    Returns:
        The table in Markdown.
    """
    config = config.filled()
    methods = get_methods(config.policy, allow=config.allow)
    make_folder(config.out)  # an error about it comes before the episodes
    find_engine(config.engine)
    find_robot(config.robot)
    find_tool(config.tool)
    blind = config.engine == "sapien" and config.rendered and find_render_device() is None
    rendered = config.rendered and not blind
    scenarios = _draw_scenarios(config)
    runs: dict[str, list[Episode]] = {}
    arm: Frames = {}
    for k, method in enumerate(methods):
        runs[method.name], frames = _run(method, scenarios, config, rendered and k == 0)
        arm.update(frames)
    table = _table(runs, config)
    print("\n" + table)
    _write_pictures(config, runs)
    (config.out / "table.md").write_text(table, encoding="utf-8")
    told = "no arm.mp4: no Vulkan device" if blind else "no arm.mp4"
    if arm:
        path = config.out / "arm.mp4"
        write_video(path, [*itertools.chain.from_iterable(arm[n] for n in sorted(arm))], fps=8)
        told = f"{path}, from the side"
    print(f"Wrote {config.out}/demo.mp4 ({told}), table.md and a picture of each family.")
    return table


def _draw_scenarios(config: DemoConfig) -> list[Scenario]:
    """The episodes, family by family; the first ones, which the video shows, are of all objects, too."""
    return [
        _draw_scenario(config, scene, family, k)
        for family, scene in enumerate(config.scenes)
        for k in range(config.episodes)
    ]


def _draw_scenario(config: DemoConfig, scene: str, family: int, k: int) -> Scenario:
    """An episode of a family with the next object in turn that finds room in it."""
    turn = (family + k) % len(config.pushed_object)
    objects = config.pushed_object[turn:] + config.pushed_object[:turn]
    parts: Any = {"robot": config.robot, "tool": config.tool, "goal": config.goal}
    for name in objects:
        drawn_from = ScenarioConfig(
            scene=scene,
            pushed_object=name,
            difficulty=config.difficulty,
            distance=_DISTANCE if config.goal == "position" else _POSE_DISTANCE,
            obstacle_between=config.goal == "pose",
            path_inflation="inscribed" if scene in TIGHT_SCENES else "circumscribed",
        )
        try:
            return sample_scenario(np.random.default_rng([config.seed, k]), drawn_from, **parts)
        except ValueError as error:  # mazes hardly have room for the large objects
            reason = error
    raise reason


def _run(
    method: Method, scenarios: Sequence[Scenario], config: DemoConfig, rendered: bool
) -> tuple[list[Episode], Frames]:
    """One policy's episodes, in order, and rendered pictures of the first of each family."""
    frames: Frames = {}
    steps: Counter[int] = Counter()
    num_envs = min(8, len(scenarios))
    # Where only the inscribed circle passes, every policy must plan with it.
    tight = any(scenario.scene in TIGHT_SCENES for scenario in scenarios)
    conditions = EpisodeConditions(
        inflation="inscribed" if tight else "circumscribed",
        goal=config.goal,
        position_tolerance=GOAL_THRESHOLD if config.goal == "position" else _POSITION_TOLERANCE,
        robot=config.robot,
        tool=config.tool,
        engine=config.engine,
        sim_freq=None,  # the engine's own
    )
    env: EnvBase = method.make_env(num_envs, config.pushed_object, conditions, pictures=rendered)
    simulator = env.base_env
    assert isinstance(simulator, PushEnv)

    def record_frame(scene: int, number: int) -> None:
        steps[number] += 1
        # A software renderer takes a fifth of a second a frame: every other step, and at most 50 frames.
        wanted = number % config.episodes == 0 and steps[number] % 2 and steps[number] <= 100
        if rendered and wanted:
            frames.setdefault(number, []).append(simulator.render(scene))

    running = run_episodes(
        env,
        method.make_policy(),
        enumerate(scenarios),
        path_key=method.path_key,
        target_key=method.target_key,
        on_step=record_frame,
    )
    bar = tqdm(running, total=len(scenarios), unit="episode", desc=method.name)
    episodes = sorted(bar, key=lambda episode: episode.number)
    env.close()
    return episodes, frames


def _table(runs: Mapping[str, Sequence[Episode]], config: DemoConfig) -> str:
    """Means by family and policy."""
    rows = pd.DataFrame(
        [
            {"scene": e.scenario.scene, "policy": name, **e.metrics.to_dict()}
            for name, episodes in runs.items()
            for e in episodes
        ]
    )
    columns = ["success", "contact_rate", "collision_rate", "spl", "steps"]
    means = rows.groupby(["scene", "policy"], sort=False)[columns].mean().loc[list(config.scenes)]
    return format_table(means.reset_index().set_index("scene"))


def _write_pictures(config: DemoConfig, runs: Mapping[str, Sequence[Episode]]) -> None:
    """A picture of each family with a row for each policy, and the video of their first episodes."""
    video: list[NDArray[np.uint8]] = []
    for k, scene in enumerate(config.scenes):
        shown = {
            name: episodes[k * config.episodes : (k + 1) * config.episodes]
            for name, episodes in runs.items()
        }
        pictures = [_last_picture(name, e) for name, episodes in shown.items() for e in episodes]
        sheet = contact_sheet(pictures, columns=config.episodes, width=480)
        write_picture(config.out / f"{scene}.png", sheet)
        clips = [_clip(name, episodes[0]) for name, episodes in shown.items()]
        video += join_clips(clips)
    write_video(config.out / "demo.mp4", video)


def _clip(name: str, episode: Episode) -> list[NDArray[np.uint8]]:
    """A picture of each step, and the one that says how the episode ended for two seconds."""
    scenario, course = episode.scenario, episode.trajectory
    title = _title(name, episode)
    pictures = [
        draw_episode(scenario, course, step=step, caption=f"{title}\nstep {step}")
        for step in range(len(course.object_pose) - 1)
    ]
    return pictures + [_last_picture(name, episode)] * 30


def _last_picture(name: str, episode: Episode) -> NDArray[np.uint8]:
    caption = f"{_title(name, episode)}\n{_verdict(episode)}"
    return draw_episode(episode.scenario, episode.trajectory, caption=caption)


def _title(name: str, episode: Episode) -> str:
    return f"{name} pushes {episode.scenario.pushed_object}, {episode.scenario.scene}"


def _verdict(episode: Episode) -> str:
    """Outcome of an episode in words, for captions."""
    metrics = episode.metrics
    if metrics.success:
        return f"solved in {metrics.steps} steps"
    if metrics.out_of_bounds:
        return f"failed: the object left the workspace after {metrics.steps} steps"
    return (
        f"failed: {100 * metrics.final_distance:.0f} cm from the goal after {metrics.steps} steps"
    )


def main(arguments: Sequence[str]) -> None:
    """`modpush demo <arguments>`."""
    torch.set_num_threads(1)
    config = tyro.cli(DemoConfig, prog="modpush demo", args=[*arguments])
    show_demo(config)
