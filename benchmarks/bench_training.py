"""The whole training loop and its parts: where the time of a scene-step and of an update goes.

    python benchmarks/bench_training.py
    python benchmarks/bench_training.py --preset cpu --seconds 20 --encoder rays --agent None

One table: each part alone, their sum beside the loop that joins them, acting alone, learning alone,
both in two processes on two cores and taking turns on one, each with the seconds of an evaluation on
the held-out episodes; memory with a full buffer; depth to action. Everything on one thread a process,
but for a row of the loop in which the learner has a thread for each core.
Memory comes first, in a process that has done nothing else, and is what Linux calls proportional set
size: pages that both processes share are counted once.
"""

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")

import statistics
import sys
import tempfile
import time
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import psutil
import torch
import tyro
from tensordict import TensorDict
from torchrl.envs import Compose, ExplorationType, set_exploration_type
from torchrl.envs.utils import step_mdp

from modpush._precision import networks_in
from modpush._processes import torch_threads
from modpush.agents import make_tqc
from modpush.recipes import load_agent, make_push_env
from modpush.replay import MirrorTransitions, extend_rollout, make_replay_buffer
from modpush.training import TRAIN_PRESETS, TrainConfig, Trainer
from modpush.training.learner import weights_of
from modpush.training.worker import SceneWorker, StartMethod


@dataclass(frozen=True, kw_only=True)
class BenchConfig:
    """What is measured."""

    preset: str = "cpu"
    """Training preset."""
    encoder: str | None = None
    """Instead of the preset's."""
    agent: str | None = "small_cube"
    """Whose weights act at first, so that episodes end as often as in a run that has learned to push;
    None for untrained ones, as other presets and encoders need."""
    seconds: float = 15.0
    """Of each loop."""


def config_of(bench: BenchConfig, **changes: Any) -> TrainConfig:
    config = TRAIN_PRESETS[bench.preset]
    if bench.encoder is not None:
        config = replace(config, env=replace(config.env, encoder=bench.encoder))
    # The last stage from the start: the scenes that most of a run is spent in.
    curriculum = replace(config.curriculum, promotion="off")
    return replace(config, curriculum=curriculum, init_from=bench.agent, progress=False, **changes)


def median_ms(function: Callable[[], Any], rounds: int = 60, first: int = 5) -> float:
    for _ in range(first):
        function()
    times = []
    for _ in range(rounds):
        began = time.perf_counter()
        function()
        times.append(time.perf_counter() - began)
    return 1e3 * statistics.median(times)


@contextmanager
def timed(env: Any) -> Iterator[dict[str, list[float]]]:
    """Collect the time of the base environment and of each transform, step by step [s]."""
    spent: dict[str, list[float]] = {}

    def watch(owner: Any, name: str, label: str) -> None:
        method = getattr(owner, name)

        def call(*args: Any, **kwargs: Any) -> Any:
            began = time.perf_counter()
            try:
                return method(*args, **kwargs)
            finally:
                spent.setdefault(label, []).append(time.perf_counter() - began)

        object.__setattr__(owner, name, call)

    watch(env.base_env, "_step", "PushEnv: physics and depth")
    assert isinstance(env.transform, Compose)
    for transform in env.transform:
        watch(transform, "_step", type(transform).__name__)
    watch(env.transform, "inv", "ActionFrame")
    yield spent


def acting(config: TrainConfig) -> list[tuple[str, float]]:
    """Milliseconds a scene-step: each part, their sum, and all of them at work."""
    worker = SceneWorker(config)
    worker.restart(0)
    actor = worker.actor if config.init_from is None else load_agent(config.init_from).actor
    weights = {k: v.numpy() for k, v in actor.state_dict().items()}
    for _ in range(30):  # until the scenes are at different times of their episodes
        worker.collect(8, weights)
    scenes = config.env.num_envs
    steps = config.rollout_length
    loop = median_ms(lambda: worker.collect(steps, weights), 100) / steps / scenes
    # The parts, on the very states that the loop is in.
    env, td = worker.env, worker._td
    assert td is not None
    with networks_in(worker._precision):
        policy = median_ms(lambda: worker._act(td.clone(False))) / scenes
        with timed(env) as spent:
            for _ in range(100):
                td, following = env.step_and_maybe_reset(worker._act(td))
                td = following
        reset = resetting(worker, td) / scenes
    rows = [(name, 1e3 * statistics.median(times) / scenes) for name, times in spent.items()]
    rows = [(name, ms) for name, ms in rows if ms > 0.0005]
    rows += [("policy with exploration", policy), ("resets", reset)]
    total = sum(ms for _, ms in rows)
    worker.close()
    return [*rows, ("sum of the parts", total), ("acting, all together", loop)]


def resetting(worker: SceneWorker, td: Any, steps: int = 300) -> float:
    """Milliseconds a step of all scenes that go into resets: one reset's time by how often."""
    env = worker.env
    mask = torch.zeros(env.batch_size[0], 1, dtype=torch.bool)
    mask[0] = True
    one = median_ms(lambda: env.reset(td.copy().set("_reset", mask.clone())), 30)
    resets = 0
    for _ in range(steps):
        td, following = env.step_and_maybe_reset(worker._act(td))
        resets += int(td["next", "done"].any())
        td = following
    return one * resets / steps


def learning(config: TrainConfig, buffer_size: int) -> list[tuple[str, float]]:
    """Milliseconds an update: sample, optimisation step, both in the run."""
    env = make_push_env(replace(config.env, num_envs=1))
    agent = make_tqc(config.tqc, env)
    width = env.observation_spec["observation"].shape[-1]
    env.close()
    replay = config.filled_replay()  # with the keys of mirror images where there are any
    buffer = make_replay_buffer(replace(replay, capacity=buffer_size, num_queries=16))
    if config.mirror:
        buffer.append_transform(MirrorTransitions())
    walk = torch.randn(buffer_size // config.env.num_envs + 1, config.env.num_envs, width)
    extend_rollout(buffer, random_transitions(config, walk), config.env.num_envs)
    sample = median_ms(lambda: buffer.sample())
    batch = buffer.sample()
    update = median_ms(lambda: agent.update(batch.clone(False)))
    both = median_ms(lambda: agent.update(buffer.sample()))
    return [("sample", sample), ("update", update), ("sample and update", both)]


@contextmanager
def running(
    config: TrainConfig, start_method: StartMethod = "spawn"
) -> Iterator[tuple[Trainer, Callable[[], None]]]:
    """A run beyond its start, and a function that takes it one rollout further."""
    with tempfile.TemporaryDirectory() as folder:
        never = 10**9
        config = replace(
            config,
            evaluate_every=never,
            checkpoint_every=never,
            log_every=never,
            total_steps=never,
            tqc=replace(config.tqc, learning_starts=2_000),
        )
        trainer = Trainer(config, Path(folder) / "run", start_method=start_method)
        trainer.worker.call(SceneWorker.restart, trainer.worker_seed())
        trainer.collect()

        def once() -> None:
            before = trainer.steps
            trainer.store(trainer.worker.result())
            trainer.collect()
            trainer.learner.learn(before, trainer.steps)

        while trainer.steps < 3_500:
            once()
        try:
            yield trainer, once
        finally:
            trainer.worker.discard()
            trainer.close()


def evaluate(trainer: Trainer) -> None:
    """Run the held-out episodes, as a run does now and then."""
    trainer.held_out_rows(weights_of(trainer.learner.averaged_actor))


def speed(config: TrainConfig, seconds: float) -> tuple[float, float]:
    """Scene-steps/s and updates/s of a run."""
    with running(config) as (trainer, once):
        began, steps, updates = time.perf_counter(), trainer.steps, trainer.learner.updates
        while time.perf_counter() - began < seconds:
            once()
        spent = time.perf_counter() - began
        return (trainer.steps - steps) / spent, (trainer.learner.updates - updates) / spent


def evaluation(config: TrainConfig) -> float:
    """Seconds of an evaluation with the first weights."""
    with tempfile.TemporaryDirectory() as folder:
        trainer = Trainer(config, Path(folder) / "run")
        evaluate(trainer)  # makes the environments
        ms = median_ms(lambda: evaluate(trainer), rounds=3, first=0)
        trainer.close()
    return ms / 1e3


def memory(config: TrainConfig) -> list[tuple[str, float]]:
    """Both processes' memory [MB]: after an evaluation, and then with a full buffer."""
    with running(config, "fork" if sys.platform == "linux" else "spawn") as (trainer, once):
        once()
        trainer.worker.discard()
        evaluate(trainer)
        nearly_empty = proportional_set_size()
        width, scenes = trainer.learner.observation_dim, config.env.num_envs
        observations = torch.randn(scenes, width)
        while len(trainer.learner.buffer) < config.replay.capacity:
            observations = fill(trainer, observations)
        trainer.learner.buffer.sample()
        full = proportional_set_size()
    rows = [("buffer nearly empty", nearly_empty), ("buffer full", full)]
    return [
        (f"both processes, {name}{what}", sizes[key])
        for name, sizes in rows
        for key, what in (("pss", ""), ("anonymous", ", without the libraries' files"))
    ]


def fill(trainer: Trainer, observations: torch.Tensor, steps: int = 500) -> torch.Tensor:
    """Write an episode of each scene into the buffer, random numbers; returns the last state."""
    scenes, width = observations.shape
    walk = torch.cat([observations[None], torch.randn(steps, scenes, width)])
    transitions = random_transitions(trainer.config, walk)
    extend_rollout(trainer.learner.buffer, transitions, scenes)
    return torch.randn(scenes, width)


def random_transitions(config: TrainConfig, walk: torch.Tensor) -> TensorDict:
    """Transitions `[T * B]` along observations `[T + 1, B, n]`, all of which end with the last step."""
    steps, scenes = len(walk) - 1, walk.shape[1]
    ends = torch.zeros(steps, scenes, 1, dtype=torch.bool)
    ends[-1] = True
    now = {"observation": walk[:-1], "action": torch.rand(steps, scenes, 3) * 2 - 1}
    after = {"observation": walk[1:], "reward": torch.randn(steps, scenes, 1)}
    after |= {"done": ends, "terminated": ends.clone()}
    if config.mirror:
        mirrored = torch.randn_like(walk)
        now["mirrored_observation"], after["mirrored_observation"] = mirrored[:-1], mirrored[1:]
    return TensorDict({**now, "next": after}, [steps, scenes]).reshape(-1)


def proportional_set_size() -> dict[str, float]:
    """This process and its children [MB]; `anonymous` is what cannot be read from a file again."""
    total = {"pss": 0.0, "anonymous": 0.0}
    for process in [psutil.Process(), *psutil.Process().children(recursive=True)]:
        with open(f"/proc/{process.pid}/smaps_rollup", encoding="utf-8") as file:
            sizes = {line.split(":")[0]: line.split()[1] for line in file.readlines()[1:]}
        total["pss"] += int(sizes["Pss"]) * 1.024e-3
        total["anonymous"] += int(sizes["Pss_Anon"]) * 1.024e-3
    return total


def depth_to_action(config: TrainConfig) -> float:
    """Milliseconds from one scene's depth image to its action, transforms and policy."""
    worker = SceneWorker(replace(config, env=replace(config.env, num_envs=2), greedy_envs=0))
    env = make_push_env(replace(config.env, num_envs=1), keep_images=True, seed=0)
    td = env.reset()
    td = env.step(env.rand_action(td))
    before, after = td.exclude("next"), td["next"]

    def think() -> None:
        seen = env.transform._step(before, after.clone(False))
        with torch.no_grad(), set_exploration_type(ExplorationType.DETERMINISTIC):
            worker.actor(step_mdp(before.clone(False).set("next", seen)))

    ms = median_ms(think, 100)
    env.close()
    worker.close()
    return ms


def main(bench: BenchConfig) -> None:
    torch.set_num_threads(1)
    config = config_of(bench)
    used = memory(config)
    scenes = config.env.num_envs
    print(f"\npreset {bench.preset}, {scenes} scenes, encoder {config.env.encoder}\n")
    print("| acting | ms a scene-step | share |\n|---|---|---|")
    rows = acting(config)
    total = dict(rows)["sum of the parts"]
    for name, ms in rows:
        print(f"| {name} | {ms:.3f} | {ms / total:.0%} |")
    print("\n| learning | ms |\n|---|---|")
    learned = learning(config, 200_000)
    for name, ms in learned:
        print(f"| {name}, {config.tqc.hidden_sizes}, batch {config.tqc.batch_size} | {ms:.2f} |")
    acted = dict(rows)["acting, all together"]
    update = dict(learned)["sample and update"]
    print("\n| the loop | scene-steps/s | updates/s | busy with its parts | evaluation [s] |")
    print("|---|---|---|---|---|")
    cores = os.cpu_count() or 1
    for name, apart, threads in (
        ("in two processes", True, 1),
        (f"the same, the learner on {cores} threads", True, cores),
        ("taking turns", False, 1),
    ):
        settings = replace(config, async_collection=apart)
        with torch_threads(threads):
            steps, updates = speed(settings, bench.seconds)
        act, learn = steps * acted / 1e3, updates * update / 1e3
        busy = max(act, learn) if apart else act + learn
        print(f"| {name} | {steps:.0f} | {updates:.0f} | {busy:.0%} | {evaluation(settings):.1f} |")
    print(f"\n| memory ({config.replay.capacity:,} transitions at most) and latency | |\n|---|---|")
    for name, size in used:
        print(f"| {name} | {size:.0f} MB |")
    print(f"| depth image to action, one scene | {depth_to_action(config):.2f} ms |")


if __name__ == "__main__":
    warnings.filterwarnings("ignore", message="Failed to find system libvulkan")
    main(tyro.cli(BenchConfig, description=__doc__))
