"""Speed and memory of the environment, each row beside its floor or its peer, in one run.

    python benchmarks/bench_env.py            # about 3 minutes; --quick for one

Every figure is a median over interleaved repetitions, one thread. The floor replays the very joint
targets of the environment's run through bare SAPIEN calls, in the same scenes, from the same state;
going back to that state is in nobody's time.
"""

import concurrent.futures
import functools
import time
import warnings
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import psutil
import torch
import tyro
from torchrl.collectors import Collector, MultiSyncCollector
from torchrl.envs import ExcludeTransform, ParallelEnv, TransformedEnv

from modpush.envs import OBSTACLE_SCENES, PushEnv, find_render_device
from modpush.envs.depth.analytic import AnalyticDepthCamera
from modpush.envs.depth.raycast import blank_image
from modpush.envs.engines.base import ENGINES
from modpush.envs.engines.sapien.engine import SapienEngine
from modpush.envs.engines.sapien.maniskill_task import ClutterPushEnv

NUM_ENVS = 8
Row = tuple[str, str, str]


@dataclass(frozen=True, kw_only=True)
class Config:
    """How long to measure."""

    quick: bool = False
    """A third of the repetitions."""


def actions(steps: int, seed: int = 0) -> torch.Tensor:
    """Pushes about the workspace, `[steps, NUM_ENVS, 3]`: half the noise kept from step to step."""
    rng = np.random.default_rng(seed)
    noise = rng.uniform(-1, 1, (steps, NUM_ENVS, 3))
    for t in range(1, steps):
        noise[t] = 0.8 * noise[t - 1] + 0.6 * noise[t]
    return torch.from_numpy(noise.clip(-1, 1)).float()


def timed(function: Callable[[], object]) -> float:
    """Seconds."""
    start = time.perf_counter()
    function()
    return time.perf_counter() - start


def bench_step(sim_freq: int, repetitions: int, steps: int = 40) -> list[Row]:
    """The environment's step beside the bare SAPIEN calls, per scene-step."""
    env = PushEnv(NUM_ENVS, scene=OBSTACLE_SCENES, seed=0, sim_freq=sim_freq)
    without_images = PushEnv(NUM_ENVS, scene=OBSTACLE_SCENES, seed=0, sim_freq=sim_freq, depth=None)
    todo = actions(steps)
    recorded: list[list[tuple]] = []
    advance = SapienEngine.advance

    def recording(engine: SapienEngine, position: list, velocity: list, looks: frozenset) -> list:
        recorded[-1].append((engine, position, velocity))
        return advance(engine, position, velocity, looks)

    def run(which: PushEnv) -> float:
        td = which.set_state(states[which])
        start = time.perf_counter()
        for action in todo:
            recorded.append([])
            td["action"] = action
            td = which.step(td)["next"]
        return time.perf_counter() - start

    def floor() -> float:
        env.set_state(states[env])
        start = time.perf_counter()
        for step in recorded[:steps]:
            for engine, position, velocity in step:
                px, joints = engine._scene.px, engine._joints
                last = None
                for angles, rates in zip(position, velocity, strict=True):
                    for joint, angle in zip(joints, angles, strict=True):
                        joint.set_drive_target(angle)
                    if rates != last:
                        for joint, rate in zip(joints, rates, strict=True):
                            joint.set_drive_velocity_target(rate)
                        last = rates
                    px.step()
        return time.perf_counter() - start

    states = {}
    for which in (env, without_images):
        which.reset()
        states[which] = which.get_state()
    SapienEngine.advance = recording
    run(env)
    SapienEngine.advance = advance
    run(without_images)
    floor_times, with_depth, without = [], [], []
    for _ in range(repetitions):
        floor_times.append(floor())
        with_depth.append(run(env))
        without.append(run(without_images))
    per = 1e3 / (steps * NUM_ENVS)
    base = np.median(floor_times) * per
    name = f"{sim_freq} Hz x {sim_freq // 15}"
    ratio = np.median(np.array(with_depth) / np.array(floor_times))
    ms = np.median(with_depth) * per
    rows = [
        (f"bare SAPIEN calls, {name} (floor)", f"{base:.3f} ms", "1.00x"),
        (
            f"PushEnv(8).step, depth on, {name}",
            f"{ms:.3f} ms",
            f"{ratio:.2f}x floor, {1e3 / ms:.0f} scene-steps/s",
        ),
        (
            f"PushEnv(8).step, no depth, {name}",
            f"{np.median(without) * per:.3f} ms",
            f"{np.median(np.array(without) / np.array(floor_times)):.2f}x floor",
        ),
    ]
    env.close()
    without_images.close()
    return rows


def bench_engines(repetitions: int, steps: int = 40) -> list[Row]:
    """Step without images, and load of a new layout, in every engine at its own rate."""
    envs = {
        name: PushEnv(NUM_ENVS, scene=OBSTACLE_SCENES, seed=0, engine=name, depth=None)
        for name in ENGINES
    }
    todo = actions(steps)
    stepping: dict[str, list[float]] = {name: [] for name in envs}
    loading: dict[str, list[float]] = {name: [] for name in envs}

    def run(env: PushEnv) -> None:
        for action in todo:
            td["action"] = action
            env.step(td)

    def load(env: PushEnv) -> None:
        for engine, scenario in zip(env._batch.engines, env.scenarios, strict=True):
            engine.load(scenario, env._batch._start_joints(scenario))

    for _ in range(repetitions):
        for name, env in envs.items():
            td = env.reset()
            stepping[name].append(timed(lambda env=env: run(env)))
            loading[name].append(timed(lambda env=env: load(env)))
    rows, base = [], np.array(stepping["sapien"])
    for name, env in envs.items():
        times = np.array(stepping[name])
        ms, rate = np.median(times) / (steps * NUM_ENVS) * 1e3, env.simulation.sim_freq
        what = f"PushEnv(8).step, no depth, {name}, {rate} Hz x {rate // 15}"
        beside = f"{np.median(times / base):.2f}x SAPIEN, {1e3 / ms:.0f} scene-steps/s"
        rows.append((what, f"{ms:.3f} ms", beside))
    for name, env in envs.items():
        ms = np.median(loading[name]) / NUM_ENVS * 1e3
        rows.append((f"a new layout in one scene's engine, {name}", f"{ms:.2f} ms", ""))
        env.close()
    return rows


def bench_maniskill(repetitions: int, steps: int = 40) -> list[Row]:
    """The same task through ManiSkill's stock step: our controller, and its stock one."""
    rows = []
    for mode, width in (("planar", 3), ("pd_joint_delta_pos", 6)):
        task = ClutterPushEnv(obs_mode="state_dict", scene=list(OBSTACLE_SCENES), control_mode=mode)
        rng = np.random.default_rng(0)
        todo = rng.uniform(-1, 1, (steps, width)).astype(np.float32) * (1 if width == 3 else 0.2)
        times = []
        for seed in range(repetitions):
            task.reset(seed=seed)
            times.append(timed(lambda task=task, todo=todo: [task.step(a) for a in todo]))
        ms = np.median(times) / steps * 1e3
        rows.append(
            (f"ManiSkill's own step, state only, {mode}, 120 Hz x 8", f"{ms:.3f} ms", "peer")
        )
        task.close()
    return rows


def bench_depth_camera(repetitions: int) -> list[Row]:
    """The image alone, per scene."""
    env = PushEnv(1, scene=OBSTACLE_SCENES, depth=None)
    bare, armed = (AnalyticDepthCamera(env._batch, arm) for arm in (False, True))
    image = blank_image()
    times: dict[str, list[float]] = {}
    for seed in range(repetitions):
        env.reset(seed=seed)
        for name, call in {
            "analytic depth 256 x 256, layout drawn anew": lambda: bare.reset(0),
            "analytic depth 256 x 256, no arm, layout cached": lambda: bare.capture(0, *image),
            "analytic depth 256 x 256, with the arm": lambda: armed.capture(0, *image),
        }.items():
            armed.reset(0)
            times.setdefault(name, []).append(
                min(timed(lambda call=call: [call() for _ in range(5)]) / 5 for _ in range(3))
            )
    env.close()
    rows = [(name, f"{np.median(values) * 1e3:.3f} ms", "") for name, values in times.items()]
    if find_render_device() is not None:
        env = PushEnv(1, depth="sapien", scene="slot")
        env.reset()
        values = [timed(env._batch.capture) for _ in range(7)]
        rows.append(("SAPIEN's rendered depth", f"{np.median(values) * 1e3:.1f} ms", "peer"))
        env.close()
    return rows


def bench_reset(repetitions: int) -> list[Row]:
    """A partial reset to a new layout, beside ManiSkill's reconfigure."""
    env = PushEnv(NUM_ENVS, scene=OBSTACLE_SCENES, seed=0)
    td = env.reset()
    times = []
    for i in range(repetitions * 4):
        mask = torch.zeros(NUM_ENVS, 1, dtype=torch.bool)
        mask[i % NUM_ENVS] = True
        td["_reset"] = mask
        times.append(timed(lambda: env.reset(td)))
    env.close()
    task = ClutterPushEnv(obs_mode="none", scene=list(OBSTACLE_SCENES))
    stock = [timed(lambda: task.reset(options={"reconfigure": True})) for _ in range(5)]
    task.close()
    return [
        (
            "partial reset of one scene, new layout, images of all 8",
            f"{np.median(times) * 1e3:.2f} ms",
            "",
        ),
        ("ManiSkill's reset with reconfigure", f"{np.median(stock) * 1e3:.0f} ms", "peer"),
    ]


def bench_memory() -> list[Row]:
    """Resident memory of one more scene."""
    process = psutil.Process()
    first = PushEnv(1, scene=OBSTACLE_SCENES)
    first.reset()
    before = process.memory_info().rss
    many = PushEnv(16, scene=OBSTACLE_SCENES)
    many.reset()
    each = (process.memory_info().rss - before) / 16 / 2**20
    first.close()
    many.close()
    return [("memory of one more scene", f"{each:.1f} MiB", "")]


def without_images(num_envs: int) -> TransformedEnv:
    """An environment that keeps its images to itself, as one that encodes them does."""
    torch.set_num_threads(1)
    env = PushEnv(num_envs, scene=OBSTACLE_SCENES, seed=0)
    return TransformedEnv(env, ExcludeTransform("depth", "segmentation"))


def bench_scaling(repetitions: int, steps: int = 30) -> list[Row]:
    """Eight scenes on two cores, step by step: one process, two threads, two processes."""
    half = functools.partial(PushEnv, NUM_ENVS // 2, scene=OBSTACLE_SCENES, seed=0)
    whole, pair = PushEnv(NUM_ENVS, scene=OBSTACLE_SCENES, seed=0), [half(), half()]
    processes = ParallelEnv(2, half)

    def run(env: PushEnv | ParallelEnv) -> None:
        td = env.reset()
        for action in actions(steps):
            td["action"] = action.reshape(-1)[: 3 * env.batch_size.numel()].view(*env.batch_size, 3)
            td = env.step(td)["next"]

    times: dict[str, list[float]] = {}
    with concurrent.futures.ThreadPoolExecutor(2) as pool:
        ways: dict[str, Callable[[], object]] = {
            "one process": lambda: run(whole),
            "two threads": lambda: list(pool.map(run, pair)),
            "ParallelEnv of two processes": lambda: run(processes),
        }
        for way in ways.values():
            way()  # the first is not counted
        for _ in range(max(repetitions // 2, 2)):
            for name, way in ways.items():
                times.setdefault(name, []).append(timed(way))
    for env in (whole, *pair, processes):
        env.close()
    return _rates("8 scenes", times, dict.fromkeys(times, NUM_ENVS * steps))


def bench_collectors(repetitions: int, steps: int = 40) -> list[Row]:
    """Whole batches collected with random actions, resets and all: one process, two processes."""
    make = functools.partial(without_images, NUM_ENVS)
    frames = {"one process": NUM_ENVS * steps, "two processes": 2 * NUM_ENVS * steps}
    times: dict[str, list[float]] = {}
    for name, count in frames.items():
        collector = (
            Collector(make, None, frames_per_batch=count, total_frames=-1)
            if name == "one process"
            else MultiSyncCollector([make, make], None, frames_per_batch=count, total_frames=-1)
        )
        batches = iter(collector)
        next(batches)  # builds, and is not counted
        next(batches)
        times[name] = [timed(lambda it=batches: next(it)) for _ in range(max(repetitions, 4))]
        collector.shutdown()
    return _rates("collector, 8 scenes a process, images kept there", times, frames)


def _rates(what: str, times: dict[str, list[float]], frames: dict[str, int]) -> list[Row]:
    """Scene-steps a second by way, beside the first way's."""
    rates = {name: frames[name] / np.median(values) for name, values in times.items()}
    first = rates["one process"]
    return [
        (f"{what}, {name}", f"{rate:.0f} scene-steps/s", f"{rate / first:.2f}x one process")
        for name, rate in rates.items()
    ]


def main(config: Config) -> None:
    """Measure and print one table."""
    torch.set_num_threads(1)
    n = 3 if config.quick else 9
    rows = [
        *bench_memory(),  # first: later, it would find memory that was freed before
        *bench_step(120, n),
        *bench_step(240, n),
        *bench_engines(n),
        *bench_maniskill(n),
        *bench_depth_camera(n * 3),
        *bench_reset(n * 2),
        *bench_scaling(n),
        *bench_collectors(n),
    ]
    print("| what | median | beside |\n|---|---|---|")
    for row in rows:
        print("| " + " | ".join(row) + " |")


if __name__ == "__main__":
    warnings.filterwarnings("ignore")
    main(tyro.cli(Config, description=__doc__))
