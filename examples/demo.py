"""Watch a UR5 push: the corridor controller in every scene family, with a table, pictures, a video.

    python examples/demo.py                      # what `make demo` runs
    python examples/demo.py --episodes 8 --scenes slot posts
    python examples/demo.py --policy scripted    # a simpler pusher, along the planner's sub-goals

Writes `runs/demo/`: `table.md`, one picture per family and `demo.mp4`. Magenta are the first planned
path and the present sub-goal. With a Vulkan device the video is rendered by SAPIEN, else it is the
drawn top view of the same episodes.
"""

import warnings
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pandas as pd
import torch
import tyro
from evaluate import METHODS, PolicyName
from torchrl.envs import EnvBase
from tqdm import tqdm

from modpush.envs import SCENES, PushEnv, ScenarioConfig, find_render_device, sample_scenario
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
    """What the demo shows."""

    policy: PolicyName = "corridor"
    """Who pushes."""
    scenes: tuple[str, ...] = field(default_factory=lambda: tuple(SCENES))
    """Scene families."""
    episodes: int = 4
    """Per family; the first is in the video."""
    pushed_object: str = "small_cube"
    """What is pushed."""
    difficulty: float = 0.3
    """Of the scenes, 0 to 1."""
    seed: int = 0
    """Of the first episode."""
    out: Path = Path("runs/demo")
    """Folder to write to."""
    rendered: bool = True
    """Use SAPIEN's renderer for the video where there is one."""


def run(config: DemoConfig, rendered: bool) -> tuple[list[Episode], dict[int, list[np.ndarray]]]:
    """All families' episodes, in order, and rendered frames of each family's first."""
    print("The first run on a machine compiles for about a minute before the arm moves.")
    method = METHODS[config.policy]
    scenarios = [
        sample_scenario(
            np.random.default_rng([config.seed, k]),
            ScenarioConfig(
                scene=scene, pushed_object=config.pushed_object, difficulty=config.difficulty
            ),
        )
        for scene in config.scenes
        for k in range(config.episodes)
    ]
    frames: dict[int, list[np.ndarray]] = {}
    num_envs = min(8, len(scenarios))
    env: EnvBase = method.make_env(num_envs, (config.pushed_object,), pictures=rendered)
    simulator = env.base_env
    assert isinstance(simulator, PushEnv)

    def look(scene: int, number: int) -> None:
        if rendered and number % config.episodes == 0:
            frames.setdefault(number, []).append(simulator.render(scene))

    running = run_episodes(
        env,
        method.make_policy(),
        enumerate(scenarios),
        path_key=method.path_key,
        target_key=method.target_key,
        on_step=look,
    )
    episodes = list(tqdm(running, total=len(scenarios), unit="episode"))
    env.close()
    return sorted(episodes, key=lambda episode: episode.number), frames


def main(config: DemoConfig) -> None:
    """Run, print the table, write pictures and video."""
    torch.set_num_threads(1)
    rendered = config.rendered and find_render_device() is not None
    episodes, rendered_frames = run(config, rendered)
    rows = pd.DataFrame([{"scene": e.scenario.scene, **e.metrics.to_dict()} for e in episodes])
    columns = ["success", "contact_rate", "collision_rate", "spl", "steps"]
    table = format_table(rows.groupby("scene", sort=False)[columns].mean())
    print("\n" + table)
    frames: list[np.ndarray] = []
    for k, scene in enumerate(config.scenes):
        shown = episodes[k * config.episodes : (k + 1) * config.episodes]
        pictures = [
            draw_episode(e.scenario, e.trajectory, caption=f"{scene} {n}")
            for n, e in enumerate(shown)
        ]
        write_picture(config.out / f"{scene}.png", contact_sheet(pictures))
        first = shown[0]
        drawn = draw_frames(first.scenario, first.trajectory, caption=f"{config.policy}: {scene}")
        frames += rendered_frames.get(first.number) or list(drawn)
    (config.out / "table.md").write_text(table)
    write_video(config.out / "demo.mp4", frames)
    how = "rendered by SAPIEN" if rendered else "drawn, since there is no Vulkan device"
    print(f"Wrote {config.out}/demo.mp4 ({how}), {config.out}/table.md and a picture per family.")


if __name__ == "__main__":
    warnings.filterwarnings("ignore", message="Failed to find system libvulkan")
    main(tyro.cli(DemoConfig, description=__doc__))
