"""The trained agent and the corridor controller on the same episodes, as a table and a video.

    python examples/demo.py

Prints how often each of them arrives and how much of the time it touches the object, and writes
`runs/two_policies.mp4`: the top views side by side, with the planned path and the sub-goal in magenta.
The first run on a machine compiles for a minute or two. `modpush demo` shows more scenes.
"""

import argparse
import warnings
from pathlib import Path

import numpy as np
import torch

from modpush.envs import Scenario, ScenarioConfig, sample_scenario
from modpush.evaluation import Episode, run_episodes
from modpush.evaluation.report import draw_frames, join_clips, write_video
from modpush.recipes import get_method


def draw_scenarios(scene: str, count: int) -> list[Scenario]:
    """Starts of episodes; the same seeds give the same starts."""
    config = ScenarioConfig(scene=scene, pushed_object="small_cube", difficulty=0.3)
    return [sample_scenario(np.random.default_rng(seed), config) for seed in range(count)]


def run(policy: str, scenarios: list[Scenario]) -> list[Episode]:
    """All episodes with one policy, several scenes at a time, in their order."""
    method = get_method(policy)  # a policy, and the environment that it needs
    env = method.make_env(min(8, len(scenarios)), ("small_cube",))
    episodes = run_episodes(
        env,
        method.make_policy(),
        enumerate(scenarios),
        path_key=method.path_key,
        target_key=method.target_key,
    )
    done = sorted(episodes, key=lambda episode: episode.number)
    env.close()
    return done


def main(scene: str, count: int, out: Path) -> None:
    """Run both, print, and write the video."""
    torch.set_num_threads(1)  # the scenes are too few to share out
    scenarios = draw_scenarios(scene, count)
    runs = {policy: run(policy, scenarios) for policy in ("agent", "corridor")}
    for policy, episodes in runs.items():
        solved = np.mean([episode.metrics.success for episode in episodes])
        touched = np.mean([episode.metrics.contact_rate for episode in episodes])
        print(f"{policy:10} arrives in {solved:.2f} of {count} episodes, contact {touched:.2f}")
    frames: list[np.ndarray] = []
    for pair in zip(*runs.values(), strict=True):
        clips = [
            list(draw_frames(episode.scenario, episode.trajectory, caption=policy))
            for policy, episode in zip(runs, pair, strict=True)
        ]
        frames += join_clips(clips)
    write_video(out, frames)
    print(f"Wrote {out}.")


if __name__ == "__main__":
    warnings.filterwarnings("ignore", message="Failed to find system libvulkan")
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--scene", default="slot", help="scene family")
    parser.add_argument("--episodes", type=int, default=4, help="number of episodes")
    parser.add_argument("--out", type=Path, default=Path("runs/two_policies.mp4"), help="video")
    given = parser.parse_args()
    main(given.scene, given.episodes, given.out)
