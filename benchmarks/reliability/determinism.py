"""How often episodes and continuations of a state are equal to the last bit, per object.

    python benchmarks/reliability/determinism.py [--count 200] [--objects fragment]

Prints a table with one row per object. Every episode is pushed for 40 steps, every continuation for 30
steps from the midst of pushing; families take turns.
"""

import argparse
from collections.abc import Sequence
from itertools import cycle, islice
from time import perf_counter

import numpy as np
import torch
from tensordict import TensorDictBase

from modpush.envs import OBJECTS, SCENES, PushEnv, Scenario, ScenarioConfig, sample_scenario

KEYS = ("object_pose", "ee_pose", "joint_position", "object_contact", "obstacle_contact")


def make_env(num_envs: int = 1) -> PushEnv:
    """An environment with all objects and families."""
    return PushEnv(
        num_envs,
        scene=list(SCENES),
        pushed_object=list(OBJECTS),
        depth=None,
        max_episode_steps=None,
    )


def push(env: PushEnv, td: TensorDictBase, seeds: Sequence[int], steps: int) -> np.ndarray:
    """Push at the object with noise of these seeds; what was seen, `[B, steps, 14]`."""
    rngs, seen = [np.random.default_rng(seed) for seed in seeds], []
    for _ in range(steps):
        way = (td["object_pose"] - td["ee_pose"])[:, :2].double().numpy()
        way = 0.9 * way / np.maximum(np.linalg.norm(way, axis=1, keepdims=True), 1e-3)
        noise = np.stack([rng.normal(0, (0.4, 0.4, 0.5)) for rng in rngs])
        action = np.clip(np.pad(way, ((0, 0), (0, 1))) + noise, -1, 1)
        td = env.step(td.set("action", torch.from_numpy(action.astype(np.float32))))["next"]
        seen.append(torch.cat([td[key].float() for key in KEYS], -1).numpy())
    return np.stack(seen, 1)


def differing(runs: Sequence[np.ndarray], others: Sequence[np.ndarray]) -> str:
    """How many runs differ in a bit, and how far the object then is away at most."""
    count = sum(not np.array_equal(a, b) for a, b in zip(runs, others, strict=True))
    far = max(float(np.abs(a[:, :2] - b[:, :2]).max()) for a, b in zip(runs, others, strict=True))
    return f"{count} ({far:.2g} m)" if count else "0"


def compare_episodes(scenarios: Sequence[Scenario]) -> list[str]:
    """Episodes in another order, in a fresh environment, and in batches of three and of eight."""
    env, n = make_env(), len(scenarios)
    first = [push(env, env.reset(scenarios=[s]), [k], 40)[0] for k, s in enumerate(scenarios)]
    order = np.random.default_rng(1).permutation(n)
    again = [push(env, env.reset(scenarios=[scenarios[k]]), [k], 40)[0] for k in order]
    cells = [differing(again, [first[k] for k in order])]
    env.close()
    fresh = []
    for k in range(0, n, 10):
        env = make_env()
        fresh.append(push(env, env.reset(scenarios=[scenarios[k]]), [k], 40)[0])
        env.close()
    cells.append(differing(fresh, first[::10]))
    for size in (3, 8):
        env = make_env(size)
        rows = order[: n // size * size].reshape(-1, size)
        seen = [
            push(env, env.reset(scenarios=[scenarios[k] for k in row]), row, 40) for row in rows
        ]
        cells.append(differing(np.concatenate(seen), [first[k] for k in rows.ravel()]))
        env.close()
    return cells


def compare_continuations(scenarios: Sequence[Scenario]) -> list[str]:
    """Continuations of a state: once more, and in another environment; and the time of `set_state`."""
    env, other = make_env(), make_env(2)
    other.reset()
    first, again, there, seconds = [], [], [], []
    for k, scenario in enumerate(scenarios):
        push(env, env.reset(scenarios=[scenario]), [k], 20)
        state, seed = env.get_state(), [k + len(scenarios)]
        first.append(push(env, env.set_state(state), seed, 30)[0])
        if k % 2:
            push(env, env.reset(), seed, 3)
        start = perf_counter()
        td = env.set_state(state)
        seconds.append(perf_counter() - start)
        again.append(push(env, td, seed, 30)[0])
        there.append(push(other, other.set_state(state, [k % 2]), seed * 2, 30)[k % 2])
    env.close()
    other.close()
    return [differing(first, again), differing(first, there), f"{1e3 * np.median(seconds):.1f} ms"]


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--count", type=int, default=200, help="Number of episodes per object.")
    parser.add_argument("--objects", nargs="+", choices=OBJECTS, default=OBJECTS)
    options, rng = parser.parse_args(), np.random.default_rng(0)
    print("| object | other order | fresh environment | 3 scenes | 8 scenes |", end=" ")
    print("state set twice | in another environment | set_state |")
    print("|---|---|---|---|---|---|---|---|")
    for item in options.objects:
        scenarios = [
            sample_scenario(rng, ScenarioConfig(scene=scene, pushed_object=item), tool="2f85")
            for scene in islice(cycle(SCENES), options.count)
        ]
        cells = [item, *compare_episodes(scenarios), *compare_continuations(scenarios)]
        print("| " + " | ".join(cells) + " |", flush=True)


if __name__ == "__main__":
    main()
