"""Watch a UR5 push: the trained agent beside the corridor controller, in every scene family.

    python examples/demo.py                      # what `make demo` runs
    python examples/demo.py --episodes 8 --scenes slot posts
    python examples/demo.py --policy scripted    # a simpler pusher, along the planner's sub-goals

Writes `runs/demo/`: `table.md`, one picture per family and `demo.mp4`, top views of the same episodes
side by side; magenta are the first planned path and the present sub-goal. With a Vulkan device there
is `arm.mp4`, too: the first policy's episodes rendered by SAPIEN.
"""

import itertools
import warnings
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pandas as pd
import torch
import tyro
from methods import Method, get_method
from torchrl.envs import EnvBase
from tqdm import tqdm

from modpush.envs import (
    SCENES,
    PushEnv,
    Scenario,
    ScenarioConfig,
    find_render_device,
    sample_scenario,
)
from modpush.evaluation.episodes import Episode, run_episodes
from modpush.evaluation.pictures import (
    contact_sheet,
    draw_episode,
    draw_frames,
    write_picture,
    write_video,
)
from modpush.evaluation.tables import format_table


@dataclass(frozen=True, kw_only=True)
class DemoConfig:
    """Settings of the demo."""

    policy: tuple[str, ...] = ("agent", "corridor")
    """Policies to show side by side, see `evaluate.py`."""
    scenes: tuple[str, ...] = field(default_factory=lambda: tuple(SCENES))
    """Scene families to show."""
    episodes: int = 4
    """Number of episodes of each family; the first one is in the video."""
    pushed_object: str = "small_cube"
    """Name of the object that is pushed."""
    difficulty: float = 0.3
    """Difficulty of the scenes, 0 to 1."""
    seed: int = 0
    """Seed of the episodes."""
    out: Path = Path("runs/demo")
    """Folder to write to."""
    rendered: bool = True
    """Have SAPIEN render the first policy's video where there is a Vulkan device."""


def draw_scenarios(config: DemoConfig) -> list[Scenario]:
    """The episodes, family by family."""
    return [
        sample_scenario(
            np.random.default_rng([config.seed, k]),
            ScenarioConfig(
                scene=scene, pushed_object=config.pushed_object, difficulty=config.difficulty
            ),
        )
        for scene in config.scenes
        for k in range(config.episodes)
    ]


def run(
    method: Method, scenarios: list[Scenario], config: DemoConfig, rendered: bool
) -> tuple[list[Episode], dict[int, list[np.ndarray]]]:
    """One policy's episodes, in order, and rendered frames of each family's first."""
    frames: dict[int, list[np.ndarray]] = {}
    steps: Counter[int] = Counter()
    num_envs = min(8, len(scenarios))
    env: EnvBase = method.make_env(num_envs, (config.pushed_object,), pictures=rendered)
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


def join_clips(clips: list[list[np.ndarray]]) -> list[np.ndarray]:
    """Clips of different lengths next to each other; one that has ended shows its last frame."""
    length = max(map(len, clips))
    padded = [clip + [clip[-1]] * (length - len(clip)) for clip in clips]
    return [np.concatenate(frames, axis=1) for frames in zip(*padded, strict=True)]


def main(config: DemoConfig) -> None:
    """Run, print the table, write pictures and video."""
    torch.set_num_threads(1)
    methods = [get_method(policy, (config.pushed_object,)) for policy in config.policy]
    rendered = config.rendered and find_render_device() is not None
    print("The first run on a machine compiles for about a minute before the arm moves.")
    scenarios = draw_scenarios(config)
    runs: dict[str, list[Episode]] = {}
    arm: dict[int, list[np.ndarray]] = {}
    for k, method in enumerate(methods):
        runs[method.name], frames = run(method, scenarios, config, rendered and k == 0)
        arm.update(frames)
    rows = pd.DataFrame(
        [
            {"scene": e.scenario.scene, "policy": name, **e.metrics.to_dict()}
            for name, episodes in runs.items()
            for e in episodes
        ]
    )
    columns = ["success", "contact_rate", "collision_rate", "spl", "steps"]
    means = rows.groupby(["scene", "policy"], sort=False)[columns].mean().loc[list(config.scenes)]
    table = format_table(means.reset_index().set_index("scene"))
    print("\n" + table)
    write(config, runs, table, arm)


def write(
    config: DemoConfig,
    runs: dict[str, list[Episode]],
    table: str,
    arm: dict[int, list[np.ndarray]],
) -> None:
    """Table, a picture a family with a row a policy, the videos."""
    video: list[np.ndarray] = []
    for k, scene in enumerate(config.scenes):
        shown = {
            name: episodes[k * config.episodes : (k + 1) * config.episodes]
            for name, episodes in runs.items()
        }
        pictures = [
            draw_episode(e.scenario, e.trajectory, caption=f"{name}: {scene} {n}")
            for name, episodes in shown.items()
            for n, e in enumerate(episodes)
        ]
        write_picture(config.out / f"{scene}.png", contact_sheet(pictures, columns=config.episodes))
        clips = [
            list(draw_frames(e[0].scenario, e[0].trajectory, caption=f"{name}: {scene}"))
            for name, e in shown.items()
        ]
        video += join_clips(clips)
    (config.out / "table.md").write_text(table)
    write_video(config.out / "demo.mp4", video)
    rendered = list(itertools.chain.from_iterable(arm[number] for number in sorted(arm)))
    if rendered:
        write_video(config.out / "arm.mp4", rendered, fps=8)
    how = (
        f"{config.out}/arm.mp4, rendered by SAPIEN" if rendered else "no arm.mp4: no Vulkan device"
    )
    print(f"Wrote {config.out}/demo.mp4 ({how}), table.md and a picture per family.")


if __name__ == "__main__":
    warnings.filterwarnings("ignore", message="Failed to find system libvulkan")
    main(tyro.cli(DemoConfig, description=__doc__))
