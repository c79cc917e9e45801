"""Training with collectors on a Ray cluster beside the one process of a single machine.

    python benchmarks/bench_scale.py
    python benchmarks/bench_scale.py --steps 60000 --collectors 1 2 4

Three tables: training itself, as the default process and with some numbers of Ray collectors, all
with the same number of environment steps; what each hop costs; and a simulation, from the measured
times, of the same run with more collectors, each on a core of its own. Ray is begun on this machine
unless RAY_ADDRESS names a cluster.
"""

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")

import heapq
import pickle
import statistics
import tempfile
import time
import warnings
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import torch
import tyro
from bench_training import median_ms

from modpush._processes import ray_session
from modpush.training import TRAIN_PRESETS, TrainConfig, Trainer
from modpush.training.scene_worker import Rollout


@dataclass(frozen=True, kw_only=True)
class ScaleConfig:
    """What is measured."""

    preset: str = "cpu"
    """Training preset."""
    steps: int = 60_000
    """Environment steps of each run."""
    collectors: tuple[int, ...] = (1, 2)
    """Numbers of Ray collectors."""
    evaluation_episodes: int = 120
    """Held-out episodes after the last step."""


class Timed(Trainer):
    """A trainer that notes how long learning from a rollout takes, and keeps the last rollout."""

    learn_times: list[float]
    last: Rollout

    def store(self, rollout: Rollout) -> None:
        self.last = rollout
        super().store(rollout)


def train(config: TrainConfig) -> dict[str, Any]:
    """One run, and what its log says of the time after the first updates."""
    with tempfile.TemporaryDirectory() as folder:
        trainer = Timed(config, Path(folder) / "run")
        trainer.learn_times = []
        learn = trainer.learner.learn

        def timed_learn(before: int, now: int) -> None:
            began = time.perf_counter()
            learn(before, now)
            trainer.learn_times.append(time.perf_counter() - began)

        trainer.learner.learn = timed_learn  # type: ignore[method-assign]
        trainer.run()
        log = pd.read_csv(trainer.folder.log)
        evaluation = pd.read_csv(trainer.folder.evaluations).iloc[-1]
        late = log[log["step"] > config.tqc.learning_starts * 1.5]
        rollout_steps = config.rollout_length * config.env.num_envs
        updates = rollout_steps * config.tqc.updates_per_step
        # While a rollout is made the learner learns from one more than from those of other collectors.
        behind = late.get("collector/behind", pd.Series([0.0])) + 1
        return {
            "steps/s": late["speed/steps"].median(),
            "updates/s": late["speed/updates"].median(),
            "learner waits": late["speed/waiting"].mean(),
            "updates behind": behind.mean() * updates,
            "success": evaluation["success"],
            "learn": statistics.median(trainer.learn_times[-100:]),
            "rollout": trainer.last,
            "weights": trainer.learner.actor_weights(),
            "rollout_steps": rollout_steps,
        }


class _Echo:
    def __init__(self, rollout: Rollout) -> None:
        self.rollout = rollout

    def give(self) -> Rollout:
        return self.rollout

    def take(self, weights: Any) -> None:
        pass


def hops(rollout: Rollout, weights: dict[str, Any]) -> list[tuple[str, float, float]]:
    """Milliseconds and kilobytes of each hop between a collector and the learner."""
    with ray_session("bench_scale", 1) as ray:
        actor = ray.remote(num_cpus=1)(_Echo).remote(rollout)
        ray.get(actor.take.remote(None))
        size = {
            n: len(pickle.dumps(v, protocol=5)) / 1e3 for n, v in (("r", rollout), ("w", weights))
        }
        rows = [
            (
                "an empty call and its answer",
                median_ms(lambda: ray.get(actor.take.remote(None))),
                0.0,
            ),
            (
                "a rollout to the learner",
                median_ms(lambda: ray.get(actor.give.remote())),
                size["r"],
            ),
            (
                "weights to a collector",
                median_ms(lambda: ray.get(actor.take.remote(ray.put(weights)))),
                size["w"],
            ),
        ]
        ray.kill(actor)
    return rows


def simulate(collectors: int, act: float, learn: float, hop: float, steps: int) -> dict[str, float]:
    """The run with every collector on a core of its own, first come, first served.

    Args:
        collectors: Number of collectors.
        act: Time of a rollout [s].
        learn: Time in which the learner stores it and makes its updates [s].
        hop: Time in which rollout and weights travel [s].
        steps: Environment steps of a rollout.
    """
    rng = np.random.default_rng(0)
    rollouts = 200 * max(collectors, 10)
    ready = [(act * rng.uniform(0.5, 1.5), i, 0) for i in range(collectors)]
    heapq.heapify(ready)
    now = waited = 0.0
    behind = []
    for version in range(1, rollouts + 1):
        done, i, sent = heapq.heappop(ready)
        waited += max(done - now, 0.0)
        now = max(now, done)
        behind.append(version - sent)
        # It goes on at once with what is newest now, while the learner learns.
        heapq.heappush(ready, (now + hop + act * rng.normal(1.0, 0.1), i, version))
        now += learn
    return {
        "steps/s": rollouts * steps / now,
        "learner waits": waited / now,
        "rollouts behind": float(np.mean(behind[rollouts // 2 :])),
    }


def main(bench: ScaleConfig) -> None:
    torch.set_num_threads(1)
    base = replace(
        TRAIN_PRESETS[bench.preset][1],
        total_steps=bench.steps,
        evaluate_every=bench.steps,
        evaluation_episodes=bench.evaluation_episodes,
        checkpoint_every=10 * bench.steps,
        progress=False,
    )
    print(f"\npreset {bench.preset}, {bench.steps:,} steps, seed {base.seed}\n")
    print("| collection | steps/s | updates/s | learner waits | updates behind | success |")
    print("|---|---|---|---|---|---|")
    runs = {"one process (default)": train(base)}
    row("one process (default)", runs["one process (default)"])
    for number in bench.collectors:
        name = f"Ray, {number} collector{'s' * (number > 1)}"
        runs[name] = train(replace(base, collector="ray", num_collectors=number))
        row(name, runs[name])

    one = next(iter(runs.values()))
    measured = hops(one["rollout"], one["weights"])
    print("\n| hop | ms | kB | bytes an environment step |\n|---|---|---|---|")
    for name, ms, kb in measured:
        print(f"| {name} | {ms:.2f} | {kb:.1f} | {1e3 * kb / one['rollout_steps']:.0f} |")

    act = one["rollout_steps"] / one["steps/s"]  # true where the learner waits, as it does here
    hop = sum(ms for _, ms, _ in measured[1:]) / 1e3
    print(
        f"\nSimulated: a rollout of {one['rollout_steps']} steps takes a collector {act * 1e3:.0f} ms, "
        f"the learner {one['learn'] * 1e3:.0f} ms, its way {hop * 1e3:.1f} ms\n"
    )
    print("| collectors | steps/s | learner waits | rollouts behind |\n|---|---|---|---|")
    for number in (1, 2, 4, 10, 100, 1000):
        s = simulate(number, act, one["learn"], hop, one["rollout_steps"])
        waits, behind = s["learner waits"], s["rollouts behind"]
        print(f"| {number} | {s['steps/s']:.0f} | {waits:.0%} | {behind:.1f} |")


def row(name: str, run: dict[str, Any]) -> None:
    print(
        f"| {name} | {run['steps/s']:.0f} | {run['updates/s']:.1f} | {run['learner waits']:.0%} | "
        f"{run['updates behind']:.0f} | {run['success']:.2f} |",
        flush=True,
    )


if __name__ == "__main__":
    warnings.filterwarnings("ignore", message="Failed to find system libvulkan")
    main(tyro.cli(ScaleConfig, description=__doc__))
