"""Computing times of a control step, for different numbers of obstacles."""

import time
from collections.abc import Iterator
from typing import Any

import numpy as np
import pandas as pd
import torch
from torchrl.envs import EnvBase, set_exploration_type
from torchrl.envs.utils import ExplorationType, step_mdp
from tqdm import tqdm

from modpush.agents import ScriptedPusher
from modpush.envs import PushEnv
from modpush.envs.scenes.sampling import sample_scenario
from modpush.envs.scenes.scenario import Scenario, ScenarioConfig
from modpush.evaluation.tables import format_table
from paper.measure import SEED, find_method
from paper.provenance import sources_text, this_origin
from paper.tables import CONTROLLERS

__all__ = ["measure_runtime"]

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


def measure_runtime(agent: str = "small_cube", seed: int = SEED) -> str:
    """Measure the computing times of a control step.

    On this machine, one scene at a time; returns the tables in Markdown.

    Args:
        agent: The agent.
        seed: Seed from which the scenarios are drawn.
    """
    methods = dict(map(find_method, (agent, *CONTROLLERS)))
    actor = find_method(agent, recovery=False)[1].make_policy()
    makers = {name: (method.make_env, method.make_policy()) for name, method in methods.items()}
    makers["simulation"] = (_bare_env, ScriptedPusher())
    lines: list[dict[str, Any]] = []
    for name, (make_env, policy) in tqdm(makers.items(), desc="runtime", unit="method"):
        env = make_env(1, (_OBJECT,))
        try:
            if name == agent:
                lines.append({"method": name, "part": "network", **_network_times(actor, env)})
            for scene in _SCENES:
                lines += _step_times(name, env, policy, scene, _scenarios(seed, scene))
        finally:
            env.close()
    sources = sources_text("python -m paper runtime", str(seed), [this_origin()])
    return f"{sources}\n{_text(pd.DataFrame(lines), agent)}"


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
            began = time.process_time()
            policy(td)
            times.append(time.process_time() - began)
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
    """CPU time of policy and environment in each step but the first ones, `[T, 2]` [s]."""
    td = env.reset(scenarios=[scenario])
    times = []
    with set_exploration_type(ExplorationType.DETERMINISTIC):
        while True:
            marks = [time.process_time()]
            td = policy(td)
            marks.append(time.process_time())
            td = env.step(td)
            marks.append(time.process_time())
            times.append(np.diff(marks))
            if bool(td["next", "done"].any()):
                return times[2:]  # the first steps load what is compiled
            td = step_mdp(td)


def _statistics(times: np.ndarray) -> dict[str, float]:
    """Number of steps, and median CPU time [ms] of times `[N]` [s]."""
    return {"steps": len(times), "cpu_ms": 1000 * float(np.median(times))}


def _over_scenes(table: pd.DataFrame, method: str, part: str) -> float:
    """Mean of the scenes' medians, weighted by their steps [ms]."""
    own = table[(table["method"] == method) & (table["part"] == part)]
    return float(np.average(own["cpu_ms"], weights=own["steps"]))


def _text(table: pd.DataFrame, agent: str) -> str:
    network = _over_scenes(table, agent, "network")
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
                _over_scenes(table, agent, "step"),
                sum(_PRINTED.values()),
            ),
        ],
        columns=["part", "here (ms)", "paper (ms)"],
    ).set_index("part")
    steps = table[(table["part"] == "step") & (table["method"] != "simulation")]
    policies = table[(table["part"] == "policy") & table["method"].isin(CONTROLLERS)]
    return "\n".join(
        [
            format_table(beside),
            "Whole control steps, simulation included (ms):\n",
            format_table(_by_scene(steps)),
            "The controllers' own part of a step (ms):\n",
            format_table(_by_scene(policies)),
        ]
    )


def _by_scene(times: pd.DataFrame) -> pd.DataFrame:
    """Median CPU times by scene and method, in the order of the number of obstacles."""
    counted = times.assign(obstacles=times["obstacles"].astype(int))
    grid = counted.pivot_table(index=["obstacles", "scene"], columns="method", values="cpu_ms")
    return grid.sort_index().rename_axis(columns=None)
