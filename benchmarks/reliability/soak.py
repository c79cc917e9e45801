"""A million random steps over all objects, families and options: nothing breaks, tunnels or grows.

    python benchmarks/reliability/soak.py                   # 10^6 scene-steps, some 25 minutes of a core
    python benchmarks/reliability/soak.py --steps 20000     # one minute

Prints a row for each of a number of runs, every one with other options, and a row for all of them. An
option's values come up equally often. Counted are values that are not finite in anything that the
environment emits, and steps in which an object's centre passed through an obstacle; measured are the
deepest overlap that PhysX reports between an object and an obstacle or the table, and resident memory
when a run's environment has been closed.
"""

import gc
import math
import time
import warnings
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import psutil
import torch
import tyro
from numpy.typing import NDArray
from tensordict import TensorDictBase
from torchrl.envs import EnvBase

from modpush.envs import OBJECTS, SCENES, PushEnv
from modpush.mdp import RewardConfig
from modpush.planners import PLANNERS
from modpush.recipes import PushEnvConfig, make_push_env

NUM_ENVS = 8
FAST = "distance_field"
SLOW = sorted({*PLANNERS} - {FAST})
"""Planners that take up to 10 ms a plan, and are run for a twentieth of the steps."""
OPTIONS: dict[str, list[Any]] = {
    "planner": [*SLOW, *[FAST] * len(SLOW)],
    "subgoal_mode": ["fraction", "lookahead"],
    "inflation": ["circumscribed", "inscribed", 0.03],
    "encoder": ["vae", "rays", "none", "end_to_end"],
    "window_outside": ["free", "blocked"],
    "frame": ["object", "path", "base"],
    "action_frame": [None, "object", "path", "base"],
    "raw": [False, True],
    "normalisation": ["initial", "constant"],
    "oob": ["truncate", "terminate"],
    "tool": ["2f85", "rod"],
    "sim_freq": [60, 120, 240],
    "randomize_dynamics": [False, True],
    "max_episode_steps": [40, 200],
    "dynamic_obstacles": [False, True],
    "arm_in_depth": [False, True],
}


@dataclass
class Count:
    """What was seen in some steps."""

    steps: int = 0
    episodes: int = 0
    not_finite: int = 0
    tunnelled: int = 0
    overlap: float = 0.0
    """Deepest one [m]."""
    where: str = "-"
    farthest: float = 0.0
    """Farthest that an object moved in a step [m]."""
    families: set[str] = field(default_factory=set)

    def add(self, other: "Count") -> None:
        """Add what was seen in other steps."""
        for name in ("steps", "episodes", "not_finite", "tunnelled"):
            setattr(self, name, getattr(self, name) + getattr(other, name))
        if other.overlap > self.overlap:
            self.overlap, self.where = other.overlap, other.where
        self.farthest = max(self.farthest, other.farthest)
        self.families |= other.families

    def row(self) -> str:
        """Cells of a table."""
        overlap = f"{1e3 * self.overlap:.2f} mm ({self.where})"
        moved = f"{1e3 * self.farthest:.0f} mm"
        return (
            f"{self.steps} | {self.episodes} | {self.not_finite} | {self.tunnelled} | {overlap} | "
            f"{moved}"
        )


def settings(count: int, rng: np.random.Generator) -> list[dict[str, Any]]:
    """Options of `count` runs: each option's values in turn, in an order of its own."""
    columns = {}
    for name, values in OPTIONS.items():
        rounds = [rng.permutation(len(values)) for _ in range(-(-count // len(values)))]
        columns[name] = [values[i] for i in np.concatenate(rounds)[:count]]
    return [{name: columns[name][i] for name in OPTIONS} for i in range(count)]


def make_env(options: dict[str, Any], seed: int) -> EnvBase:
    """The whole stack with these options, all objects and all families."""
    given = dict(options)
    reward = RewardConfig(normalisation=given.pop("normalisation"))
    config = PushEnvConfig(num_envs=NUM_ENVS, reward=reward)
    return make_push_env(
        config, scene=tuple(SCENES), pushed_object=tuple(OBJECTS), seed=seed, **given
    )


def in_obstacles(env: PushEnv) -> list[NDArray[np.float64]]:
    """For each scene the object's centre in each obstacle's frame, `[n, 2]` [m]."""
    found = []
    for engine in env._batch.engines:
        poses = engine.obstacle_transforms()
        w, x, y, z = poses[:, 3:].T
        yaw = np.arctan2(2 * (w * z + x * y), 1 - 2 * (y**2 + z**2))
        dx, dy = (np.asarray(engine.object_transform()[:2]) - poses[:, :2]).T
        cos, sin = np.cos(yaw), np.sin(yaw)
        found.append(np.stack([cos * dx + sin * dy, cos * dy - sin * dx], -1))
    return found


def half_sizes(env: PushEnv) -> list[NDArray[np.float64]]:
    """For each scene the half sides of its obstacles, `[n, 2]` [m]."""
    return [
        np.array([o.size[:2] for o in scenario.obstacles]).reshape(-1, 2) / 2
        for scenario in env.scenarios
    ]


def crossed(before: NDArray[Any], after: NDArray[Any], half: NDArray[Any]) -> bool:
    """Whether a straight line between two points passes through one of n rectangles."""
    way = after - before
    with np.errstate(divide="ignore", invalid="ignore"):
        first, second = (-half - before) / way, (half - before) / way
    enter = np.fmax.reduce(np.minimum(first, second), axis=1, initial=0.0)
    leave = np.fmin.reduce(np.maximum(first, second), axis=1, initial=1.0)
    beside = ((way == 0) & (np.abs(before) > half)).any(1)
    return bool(((enter <= leave) & ~beside).any())


def overlap(env: PushEnv) -> tuple[float, str]:
    """Deepest overlap of an object with an obstacle or the table [m], and where."""
    worst = (0.0, "-")
    for scenario, engine in zip(env.scenarios, env._batch.engines, strict=True):
        gaps = engine.gaps()
        depth = -min(gaps["object_obstacle"], gaps["object_table"])
        worst = max(worst, (depth, f"{scenario.pushed_object} in {scenario.scene}"))
    return worst


def not_finite(td: TensorDictBase) -> int:
    """How many values of a tensordict are NaN or infinite."""
    return sum(
        int((~value.isfinite()).sum())
        for value in td.values(True, True)
        if value.is_floating_point()
    )


def run(options: dict[str, Any], steps: int, seed: int) -> Count:
    """Take `steps` scene-steps in an environment with these options."""
    env, rng, count = make_env(options, seed), np.random.default_rng(seed), Count()
    base: Any = env.base_env
    td, noise = env.reset(), np.zeros((NUM_ENVS, 3))
    count.episodes = NUM_ENVS
    halves, before = half_sizes(base), in_obstacles(base)
    for _ in range(math.ceil(steps / NUM_ENVS)):
        start = td["object_pose"][:, :2]
        # Correlated noise travels; half of the scenes are pulled to the object and touch it often.
        noise = 0.9 * noise + 0.5 * rng.normal(size=noise.shape)
        pull = (td["object_pose"] - td["ee_pose"])[:, :2].numpy() * 8
        pull[: NUM_ENVS // 2] = 0.0
        action = np.clip(noise + np.pad(pull, ((0, 0), (0, 1))), -1, 1)
        root = env.step(td.set("action", torch.from_numpy(action).float()))
        td = root["next"]
        count.steps += NUM_ENVS
        count.not_finite += not_finite(td)
        moved = (td["object_pose"][:, :2] - start).norm(dim=-1).max()
        count.farthest = max(count.farthest, float(moved))
        deepest = overlap(base)
        if deepest[0] > count.overlap:
            count.overlap, count.where = deepest
        after = in_obstacles(base)
        count.tunnelled += sum(map(crossed, before, after, halves))
        before = after
        if td["done"].any():
            done = torch.nonzero(td["done"][:, 0])[:, 0].tolist()
            count.families |= {base.scenarios[i].scene for i in done}
            count.episodes += len(done)
            td = env.reset(td.clone().set("_reset", td["done"].clone()))
            count.not_finite += not_finite(td)
            halves, before = half_sizes(base), in_obstacles(base)
    env.close()
    return count


def main(steps: int = 1_000_000, runs: int = 48, seed: int = 0) -> None:
    """Print the table.

    Args:
        steps: Number of scene-steps in all.
        runs: Number of environments, each with other options.
        seed: Seed of everything.
    """
    torch.set_num_threads(1)
    warnings.filterwarnings("ignore")
    total, memory, start = Count(), [], time.monotonic()
    process = psutil.Process()
    print(
        "| run | steps | episodes | not finite | tunnelled | deepest overlap | farthest |", end=""
    )
    print(" memory |\n|---|---|---|---|---|---|---|---|", flush=True)
    drawn = settings(runs, np.random.default_rng(seed))
    weights = [1.0 if options["planner"] == FAST else 0.05 for options in drawn]
    for i, (options, weight) in enumerate(zip(drawn, weights, strict=True)):
        count = run(options, math.ceil(steps * weight / sum(weights)), seed + 1000 * i)
        gc.collect()
        memory.append(process.memory_info().rss / 2**20)
        print(f"| {i} | {count.row()} | {memory[-1]:.0f} MiB |", flush=True)
        total.add(count)
    quarter = max(len(memory) // 4, 1)
    growth = np.median(memory[-quarter:]) - np.median(memory[quarter : 2 * quarter] or memory)
    print(f"| all | {total.row()} | {growth:+.0f} MiB |")
    minutes = (time.monotonic() - start) / 60
    print(f"{len(total.families)} of {len(SCENES)} families, {minutes:.0f} minutes")


if __name__ == "__main__":
    tyro.cli(main, description=__doc__)
