"""Collect local windows to train an encoder on: a random policy over all scenes and objects.

    python examples/collect_windows.py                       # 100k windows, the training families
    python examples/collect_windows.py --families maze_wide diagonal_walls_wide random_clutter \
        --count 6000 --held-out 1.0 --seed 1 --output runs/windows/unseen.safetensors

Writes one safetensors file with its config. A tenth of the windows are blank, the others have
something in view. An episode gives the object's own window at its start and, if the random policy
has moved it, after a few steps; and, since the object seldom moves much, windows of the same scene at
other free poses where it might have been. Yaw is uniform in all of them. Work is kept in parts beside
the output: run the same command again to continue where it was stopped.
"""

import dataclasses
import functools
import json
import shutil
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import partial
from multiprocessing import get_context
from pathlib import Path

import torch
import tyro
from torch import Tensor
from tqdm import tqdm
from window_data import WindowData

from modpush.encoders import egocentric_window
from modpush.encoders.window import WINDOW_SIZE
from modpush.envs import OBSTACLE_SCENES, PushEnv
from modpush.envs.scenes.objects import PAPER_OBJECTS
from modpush.geometry import WORKSPACE

_FREE_RADIUS_PX = 7  # of the disc that the small cube needs, 2.5 cm


@dataclass(frozen=True, kw_only=True)
class Config:
    """Settings of the collection."""

    output: Path = Path("runs/windows/train.safetensors")
    """File to write."""
    count: int = 100_000
    """Number of windows."""
    families: tuple[str, ...] = OBSTACLE_SCENES
    """Scene families, drawn from uniformly."""
    objects: tuple[str, ...] = PAPER_OBJECTS
    """Pushed objects, drawn from uniformly."""
    blank: float = 0.1
    """Share of windows that show an empty table."""
    held_out: float = 0.05
    """Share of windows, in whole scenes, that are marked as not to be trained on."""
    steps: int = 4
    """Number of steps of the random policy in each episode."""
    other_poses: int = 6
    """Number of windows taken in each scene at poses other than the object's."""
    num_envs: int = 8
    """Number of scenes that a process steps together."""
    workers: int = 2
    """Number of processes."""
    part: int = 1000
    """Number of windows written at a time; an interrupted run loses no more than these."""
    seed: int = 0
    """Seed; two runs with the same one give the same file."""

    def __post_init__(self) -> None:
        """Check ranges."""
        if self.count < 1 or self.part < 1 or self.workers < 1:
            raise ValueError("collect_windows: count, part and workers must be >= 1.")
        if not (0 <= self.blank < 1 and 0 <= self.held_out <= 1):
            raise ValueError("collect_windows: blank must lie in [0, 1), held_out in [0, 1].")

    def recipe(self) -> dict[str, object]:
        """All that the windows depend on; family k is `families[k]`, the last one is blank."""
        recipe = dataclasses.asdict(self)
        for name in ("output", "workers"):
            del recipe[name]
        return {**recipe, "families": [*self.families, "blank"], "objects": list(self.objects)}


def other_poses(
    depth: Tensor, segmentation: Tensor, count: int, generator: torch.Generator
) -> Tensor:
    """Windows `[n, 1, 64, 64]`, n <= count, at free poses of one scene with something in view."""
    low, high = torch.tensor([*WORKSPACE.low, -torch.pi]), torch.tensor([*WORKSPACE.high, torch.pi])
    poses = low + (high - low) * torch.rand(4 * count, 3, generator=generator)
    windows = torch.cat([egocentric_window(depth, segmentation, pose[None]) for pose in poses])
    steps = torch.arange(WINDOW_SIZE) - 0.5 * (WINDOW_SIZE - 1)
    near = steps[:, None] ** 2 + steps**2 < _FREE_RADIUS_PX**2
    good = (windows > 0).flatten(1).any(1) & ~(windows[:, 0, near] > 0).any(1)
    return windows[good][:count]


def episodes(
    env: PushEnv, config: Config, generator: torch.Generator
) -> Iterator[tuple[Tensor, str]]:
    """Windows `[n, 1, 64, 64]` of something, with their family, scene by scene without end."""
    while True:
        first = env.reset()
        last = first.clone()
        for _ in range(config.steps):
            last["action"] = 2 * torch.rand(last.batch_size[0], 3, generator=generator) - 1
            last = env.step(last)["next"]
        moved = (last["object_pose"] - first["object_pose"]).abs().amax(-1) > 0.002
        for i, scenario in enumerate(env.scenarios):
            for data in (first, last)[: 1 + int(moved[i])]:
                depth, labels = data["depth"][i], data["segmentation"][i]
                window = egocentric_window(depth, labels, data["object_pose"][i : i + 1])
                if (window > 0).any():
                    yield window, scenario.scene
            if config.other_poses:
                yield other_poses(depth, labels, config.other_poses, generator), scenario.scene


@functools.cache
def make_env(config: Config) -> PushEnv:
    """One for all parts of a process: seeded again, it starts as a new one would."""
    torch.set_num_threads(1)
    return PushEnv(
        config.num_envs,
        scene=config.families,
        pushed_object=config.objects,
        clearance=0.0,  # the policy pushes objects up to obstacles, so some start there
        distance=(0.05, 0.6),
        max_episode_steps=None,
    )


def collect_part(config: Config, index: int, folder: Path) -> int:
    """Collect one part and write it; returns how many windows it holds."""
    total = min(config.part, config.count - index * config.part)
    seed = config.seed * 1_000_003 + index
    generator = torch.Generator().manual_seed(seed)
    env = make_env(config)
    env.set_seed(seed * config.num_envs)
    blank = round(config.blank * total)
    windows, families = (
        [torch.zeros(blank, 1, WINDOW_SIZE, WINDOW_SIZE)],
        [len(config.families)] * blank,
    )
    for some, family in episodes(env, config, generator):
        windows.append(some)
        families += [config.families.index(family)] * len(some)
        if len(families) >= total:
            break
    held_out = index * config.part >= round((1 - config.held_out) * config.count)
    WindowData.from_floats(
        torch.cat(windows)[:total],
        torch.tensor(families[:total], dtype=torch.uint8),
        torch.full((total,), held_out),
        config.recipe(),
    ).save(folder / f"{index:05d}.safetensors")
    return total


def main(config: Config) -> WindowData:
    """Collect what is missing, join the parts, write the file."""
    folder = config.output.with_suffix(".parts")
    folder.mkdir(parents=True, exist_ok=True)
    recipe, noted = json.dumps(config.recipe()), folder / "config.json"
    if noted.exists() and noted.read_text(encoding="utf-8") != recipe:
        raise ValueError(f"collect_windows: {folder} was begun with another config; remove it.")
    noted.write_text(recipe, encoding="utf-8")
    paths = [folder / f"{i:05d}.safetensors" for i in range(-(-config.count // config.part))]
    missing = [index for index, path in enumerate(paths) if not path.exists()]
    with tqdm(total=config.count, unit="windows", desc=config.output.name) as bar:
        bar.update(max(config.count - len(missing) * config.part, 0))
        if config.workers == 1:
            for index in missing:
                bar.update(collect_part(config, index, folder))
        elif missing:
            with ProcessPoolExecutor(config.workers, mp_context=get_context("spawn")) as pool:
                for count in pool.map(partial(collect_part, config, folder=folder), missing):
                    bar.update(count)
    data = WindowData.join([WindowData.load(path) for path in paths])
    data.save(config.output)
    shutil.rmtree(folder)
    names = data.config["families"]
    shares = {name: int((data.family == k).sum()) for k, name in enumerate(names)}
    print(f"{config.output}: {len(data)} windows, {int(data.held_out.sum())} held out, {shares}")
    return data


if __name__ == "__main__":
    main(tyro.cli(Config))
