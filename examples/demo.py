"""Watch a UR5 push: a scripted pusher in every scene family, with a table, pictures and a video.

    python examples/demo.py                      # what `make demo` runs
    python examples/demo.py --episodes 8 --scenes slot posts

Writes `runs/demo/`: `table.md`, one picture per family and `demo.mp4`. With a Vulkan device the
video is rendered by SAPIEN, else it is the drawn top view of the same episodes.
"""

import warnings
from dataclasses import dataclass, field
from pathlib import Path

import cv2
import imageio
import numpy as np
import torch
import tyro
from tqdm import tqdm

from modpush.agents import ScriptedPusher
from modpush.envs import SCENES, PushEnv, find_render_device
from modpush.envs.drawing import draw_top_view


@dataclass(frozen=True, kw_only=True)
class DemoConfig:
    """What the demo shows."""

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


@torch.no_grad()
def run_family(env: PushEnv, policy: torch.nn.Module, bar: tqdm, rendered: bool) -> list[dict]:
    """One episode in each scene of the environment; a record of each, the first with frames."""
    td = env.reset()
    logs = [
        {"object": [], "tool": [], "contact": [], "collision": [], "frames": [], "scenario": s}
        for s in env.scenarios
    ]
    running = np.ones(env.batch_size[0], dtype=bool)
    while running.any():
        for i in np.flatnonzero(running):
            logs[i]["object"].append(td["object_pose"][i].tolist())
            logs[i]["tool"].append(td["ee_pose"][i].tolist())
        if rendered and running[0] and len(logs[0]["object"]) % 2:
            logs[0]["frames"].append(env.render(0))
        td = env.step(policy(td))["next"]
        for i in np.flatnonzero(running):
            logs[i]["contact"].append(bool(td["object_contact"][i]))
            hit = td["obstacle_contact"][i] | td["tool_obstacle_contact"][i]
            logs[i]["collision"].append(bool(hit))
            if td["done"][i]:
                logs[i]["success"] = bool(td["success"][i])
                running[i] = False
                bar.update()
        td["done"].zero_()  # scenes that are over idle until the last one is
    return logs


def draw(log: dict, step: int, caption: str = "") -> np.ndarray:
    """The drawn top view of one step."""
    upto = slice(0, step + 1)
    return draw_top_view(
        log["scenario"],
        log["object"][step],
        log["tool"][step],
        object_path=np.array(log["object"][upto]),
        ee_path=np.array(log["tool"][upto]),
        caption=caption,
    )


def main(config: DemoConfig) -> None:
    """Run, print the table, write pictures and video."""
    torch.set_num_threads(1)
    rendered = config.rendered and find_render_device() is not None
    config.out.mkdir(parents=True, exist_ok=True)
    policy, rows = ScriptedPusher(), []
    frames: list[np.ndarray] = []
    with tqdm(total=len(config.scenes) * config.episodes, unit="episode") as bar:
        env = PushEnv(config.episodes, depth=None, pictures=rendered, seed=config.seed)
        for scene in config.scenes:
            bar.set_description(scene)
            env.scenario = type(env.scenario)(
                scene=scene, pushed_object=config.pushed_object, difficulty=config.difficulty
            )
            logs = run_family(env, policy, bar, rendered)
            touched = [np.trim_zeros(log["contact"], "f") for log in logs]
            rows.append(
                (
                    scene,
                    np.mean([log["success"] for log in logs]),
                    np.mean([np.mean(t) if len(t) else 0.0 for t in touched]),
                    np.mean([np.mean(log["collision"]) for log in logs]),
                    np.mean([len(log["contact"]) for log in logs]),
                )
            )
            shown = [
                draw(log, len(log["object"]) - 1, f"{scene} {i}") for i, log in enumerate(logs)
            ]
            cv2.imwrite(str(config.out / f"{scene}.png"), np.hstack(shown[:4])[..., ::-1])
            frames += logs[0]["frames"] or [
                draw(logs[0], step, scene) for step in range(len(logs[0]["object"]))
            ]
    header = "| scene | success | contact | collision | steps |\n|---|---|---|---|---|\n"
    table = header + "".join(
        f"| {n} | {s:.2f} | {c:.2f} | {x:.3f} | {k:.0f} |\n" for n, s, c, x, k in rows
    )
    print("\n" + table)
    (config.out / "table.md").write_text(table)
    imageio.mimsave(config.out / "demo.mp4", frames, fps=15, macro_block_size=2)
    how = "rendered by SAPIEN" if rendered else "drawn, since there is no Vulkan device"
    print(f"Wrote {config.out}/demo.mp4 ({how}), {config.out}/table.md and a picture per family.")


if __name__ == "__main__":
    warnings.filterwarnings("ignore", message="Failed to find system libvulkan")
    main(tyro.cli(DemoConfig, description=__doc__))
