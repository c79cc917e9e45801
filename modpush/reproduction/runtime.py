"""Computing times of a control step, for different numbers of obstacles."""

import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
import pandas as pd
import torch
from torchrl.envs import EnvBase, set_exploration_type
from torchrl.envs.utils import ExplorationType, step_mdp
from tqdm import tqdm

from modpush._provenance import Session, commit, machine, sources_text
from modpush.agents import ScriptedPusher
from modpush.envs import PushEnv
from modpush.envs.scenes.sampling import sample_scenario
from modpush.envs.scenes.scenario import Scenario, ScenarioConfig
from modpush.evaluation.tables import format_table
from modpush.files import write_text
from modpush.reproduction.config import ReproduceConfig
from modpush.reproduction.measure import AGENT, agent_method, methods_for

matplotlib.use("Agg")  # no screen is needed
import matplotlib.pyplot as plt

__all__ = ["write_runtime"]

_SCENES = (
    "free",
    "bar_across",
    "slot",
    "posts",
    "corridor",
    "random_clutter",
    "maze_wide",
    "diagonal_walls_wide",
)
_EPISODES = 3  # of each scene
_WARM_UP, _CALLS = 200, 2000
_PRINTED = {"network": 0.791, "simulation": 21.91}
"""The paper's times, on an i7-6800K with an Nvidia 2070 [ms]. Source: paper Sec. V-B."""
_OBJECT = "small_cube"


def write_runtime(config: ReproduceConfig) -> None:
    """Measure on this machine, one scene at a time, and write `runtime.md`, `.csv` and `.png`."""
    began = time.perf_counter()
    methods = methods_for(config, _OBJECT)
    actor = agent_method(replace(config, recovery=False)).make_policy()
    lines: list[dict[str, Any]] = []
    makers = {name: (method.make_env, method.make_policy()) for name, method in methods.items()}
    makers["simulation"] = (_bare_env, ScriptedPusher())
    count = 0
    for name, (make_env, policy) in tqdm(
        makers.items(), desc="runtime", unit="method", disable=not config.progress
    ):
        env = make_env(1, (_OBJECT,))
        try:
            if name == AGENT:
                lines.append({"method": AGENT, "part": "network", **_network_times(actor, env)})
            for scene in _SCENES:
                scenarios = _scenarios(config.seed, scene)
                count += len(scenarios)
                lines += _step_times(name, env, policy, scene, scenarios)
        finally:
            env.close()
    table = pd.DataFrame(lines)
    write_text(config.out / "runtime.csv", table.to_csv(index=False))
    _draw(table, config.out / "runtime.png")
    seconds = time.perf_counter() - began
    session = Session(commit=commit(), machine=machine(), count=count, seconds=seconds)
    sources = sources_text(config.command("runtime"), [session], str(config.seed))
    write_text(config.out / "runtime.md", _text(table, sources))


def _bare_env(num_envs: int, objects: tuple[str, ...]) -> EnvBase:
    return PushEnv(num_envs, pushed_object=objects, depth=None)


def _scenarios(seed: int, scene: str) -> list[Scenario]:
    config = ScenarioConfig(scene=scene, pushed_object=_OBJECT, difficulty=0.5, distance=0.3)
    return [sample_scenario(np.random.default_rng([seed, n]), config) for n in range(_EPISODES)]


@torch.no_grad()
def _network_times(policy: Any, env: EnvBase) -> dict[str, float]:
    """Times of the policy's network for one observation of its environment."""
    td = env.reset().select(*policy.in_keys)
    times = []
    with set_exploration_type(ExplorationType.DETERMINISTIC):
        for _ in range(_WARM_UP + _CALLS):
            clock, wall = time.process_time(), time.perf_counter()
            policy(td)
            times.append((time.process_time() - clock, time.perf_counter() - wall))
    return _statistics(np.array(times[_WARM_UP:]))


def _step_times(
    name: str, env: EnvBase, policy: Any, scene: str, scenarios: list[Scenario]
) -> Iterator[dict[str, Any]]:
    """Times of policy, environment and both, over the steps of some episodes."""
    times = np.array([t for scenario in scenarios for t in _episode_times(env, policy, scenario)])
    about = {"method": name, "scene": scene, "obstacles": len(scenarios[0].obstacles)}
    for part, columns in (("policy", times[:, 0]), ("environment", times[:, 1])):
        yield {**about, "part": part, **_statistics(columns)}
    yield {**about, "part": "step", **_statistics(times.sum(axis=1))}


@torch.no_grad()
def _episode_times(env: EnvBase, policy: Any, scenario: Scenario) -> list[Any]:
    """For each step but the first ones (CPU time, wall time) of policy and environment, `[2, 2]` [s]."""
    td = env.reset(scenarios=[scenario])
    times = []
    with set_exploration_type(ExplorationType.DETERMINISTIC):
        while True:
            marks = [(time.process_time(), time.perf_counter())]
            td = policy(td)
            marks.append((time.process_time(), time.perf_counter()))
            td = env.step(td)
            marks.append((time.process_time(), time.perf_counter()))
            times.append(np.diff(np.array(marks), axis=0))
            if bool(td["next", "done"].any()):
                return times[2:]  # the first steps load what is compiled
            td = step_mdp(td)


def _statistics(times: np.ndarray) -> dict[str, float]:
    """Median, 95th percentile of CPU time, and median of wall time, of `[N, 2]` [s], in [ms]."""
    cpu, wall = 1000 * np.asarray(times).T
    return {
        "steps": len(cpu),
        "cpu_ms": float(np.median(cpu)),
        "cpu_ms_p95": float(np.percentile(cpu, 95)),
        "wall_ms": float(np.median(wall)),
    }


def _over_scenes(table: pd.DataFrame, method: str, part: str) -> float:
    """Mean of the scenes' medians, weighted by their steps [ms]."""
    own = table[(table["method"] == method) & (table["part"] == part)]
    return float(np.average(own["cpu_ms"], weights=own["steps"]))


def _text(table: pd.DataFrame, sources: str) -> str:
    network = _over_scenes(table, AGENT, "network")
    beside = pd.DataFrame(
        [
            ("action prediction of the network", network, _PRINTED["network"]),
            (
                "simulation of the action",
                _over_scenes(table, "simulation", "environment"),
                _PRINTED["simulation"],
            ),
            (
                "whole step: simulation, depth image, path, encoder, observation, network",
                _over_scenes(table, AGENT, "step"),
                sum(_PRINTED.values()),
            ),
        ],
        columns=["part", "here (ms)", "paper (ms)"],
    ).set_index("part")
    steps = table[(table["part"] == "step") & (table["method"] != "simulation")]
    policies = table[(table["part"] == "policy") & table["method"].str.startswith("corridor")]
    return _TEXT.format(
        sources=sources,
        beside=format_table(beside),
        grid=format_table(_by_scene(steps)),
        alone=format_table(_by_scene(policies)),
    )


def _by_scene(times: pd.DataFrame) -> pd.DataFrame:
    """Median CPU times by scene and method, in the order of the number of obstacles."""
    counted = times.assign(obstacles=times["obstacles"].astype(int))
    grid = counted.pivot_table(index=["obstacles", "scene"], columns="method", values="cpu_ms")
    return grid.sort_index().rename_axis(columns=None)


def _draw(table: pd.DataFrame, path: Path) -> None:
    figure, axis = plt.subplots(figsize=(6.4, 4.0))
    steps = table[(table["part"] == "step") & (table["method"] != "simulation")]
    for number, (method, own) in enumerate(steps.groupby("method", sort=False)):
        ordered = own.sort_values("obstacles")
        axis.plot(ordered["obstacles"], ordered["cpu_ms"], f"C{number}.-", label=str(method))
        axis.fill_between(
            ordered["obstacles"],
            ordered["cpu_ms"],
            ordered["cpu_ms_p95"],
            color=f"C{number}",
            alpha=0.12,
        )
    axis.set(xlabel="obstacles", ylabel="CPU time of a control step (ms)", ylim=(0, None))
    axis.grid(alpha=0.3)
    axis.legend()
    figure.tight_layout()
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=110)
    plt.close(figure)


_TEXT = """# Computing times

{sources}
CPU time of one thread, one scene at a time; medians over the steps of three episodes in each of
eight scenes, in the first table their mean over the scenes. Other programs on the machine change
CPU time less than wall time, which is in `runtime.csv` with the 95th percentiles.

{beside}
The paper's times are of an i7-6800K with an Nvidia 2070, in PyBullet, and it does not say whether
its 21.91 ms hold the depth image and the path. So none of these is called ahead or behind. Several
scenes in a call share its cost: see [bench_env.md](../bench_env.md).

## With the number of obstacles

The paper says that its runtime is constant, and the controller's grows with the number of
obstacles. Whole control steps, simulation included (ms):

{grid}
![CPU time of a control step, median to 95th percentile](runtime.png)

The controllers' own part of a step (ms):

{alone}"""
