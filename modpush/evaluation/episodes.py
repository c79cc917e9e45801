"""Runs given episodes through a batched environment, and yields each as it ends."""

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import partial
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from tensordict import NestedKey, TensorDictBase
from torchrl.envs import EnvBase, set_exploration_type
from torchrl.envs.utils import ExplorationType, step_mdp

from modpush._checks import read_key
from modpush.envs.scenes.objects import Circle, PushedObject
from modpush.envs.scenes.scenario import Scenario
from modpush.evaluation.metrics import (
    EpisodeMetrics,
    episode_metrics,
    obstacle_metrics,
    path_share,
    side_changes,
)
from modpush.evaluation.shortest import shortest_path
from modpush.files import read_arrays, write_arrays
from modpush.geometry.workspace import WORKSPACE

Policy = Callable[[TensorDictBase], TensorDictBase]
"""Any TensorDictModule: reads what the environment emits, writes `action`."""

# Read after every step; the flags are `episode_metrics`' `contacts`, then its `contacts_at_end`.
_POSES = ("object_pose", "ee_pose")
_FLAGS = (
    "object_contact",
    "obstacle_contact",
    "tool_obstacle_contact",
    "object_contact_at_end",
    "obstacle_contact_at_end",
    "tool_obstacle_contact_at_end",
)
_OBSTACLES = "obstacle_pose"
_ENDS = ("success", "out_of_bounds", "done")


@dataclass(frozen=True, kw_only=True)
class Trajectory:
    """Poses, contacts and paths of an episode of T control steps, in the base frame [m, rad]."""

    object_pose: NDArray[np.float32]
    """Pose of the object at reset and after each step, `[T + 1, 3]`."""
    ee_pose: NDArray[np.float32]
    """Pose of the tool's tip at reset and after each step, `[T + 1, 3]`."""
    contacts: NDArray[np.bool_]
    """Contacts in each step of arm and object, object and obstacle, arm and obstacle, `[T, 3]`."""
    planned_path: NDArray[np.float32]
    """First planned path, `[n, 2]`; the common planner's where the policy has none of its own."""
    target: NDArray[np.float32]
    """Sub-goal for which the policy acted in each step, `[T, 2]`; `[0, 2]` where it has none."""
    obstacle_pose: NDArray[np.float32] | None = None
    """x, y, yaw and tilt of the obstacles at reset and after each step, `[T + 1, n, 4]`; None where they
    are fixed."""

    def save(self, path: Path) -> None:
        """Write as a compressed `.npz`, atomically."""
        write_arrays(path, {k: v for k, v in vars(self).items() if v is not None})

    @classmethod
    def load(cls, path: Path) -> "Trajectory":
        """Read what `save` wrote.

        Raises:
            FileNotFoundError: If there is no such file.
            ValueError: If it is damaged, or no trajectory.
        """
        arrays = read_arrays(path, "modpush.Trajectory")
        if (names := set(cls.__dataclass_fields__)) != {*arrays, "obstacle_pose"}:
            raise ValueError(
                f"modpush.Trajectory: {path} must hold {sorted(names - {'obstacle_pose'})}, and may hold "
                f"obstacle_pose, got {sorted(arrays)}."
            )
        return cls(**arrays)


@dataclass(frozen=True, kw_only=True)
class Episode:
    """An episode that has ended."""

    number: int
    """Number of the episode in its set."""
    scenario: Scenario
    """Start of the episode."""
    metrics: EpisodeMetrics
    """Figures of the episode."""
    trajectory: Trajectory
    """Course of the episode."""


class _Log:
    """Records of an episode that has not ended yet."""

    def __init__(
        self,
        number: int,
        scenario: Scenario,
        td: TensorDictBase,
        row: int,
        *,
        inflation: Circle,
        objects: Mapping[str, PushedObject] | None = None,
        control_freq: float = 15.0,
    ) -> None:
        self.number, self.scenario, self.objects = number, scenario, objects
        self.inflation: Circle = inflation
        self.control_freq = control_freq
        self.poses = {key: [td[key][row].tolist()] for key in _POSES}
        self.flags: list[list[bool]] = []
        self.rewards: list[float] = []
        self.targets: list[list[float]] = []
        self.path: NDArray[np.float32] | None = None
        self.yaw_error: float | None = None
        self.obstacles: list[Any] = []
        if _OBSTACLES in td.keys():
            self.obstacles.append(self.obstacles_of(td[_OBSTACLES][row]))

    def obstacles_of(self, poses: torch.Tensor) -> NDArray[np.float32]:
        """Poses of those that there are, `[n, 4]`."""
        return poses[: len(self.scenario.obstacles)].cpu().numpy().copy()

    def finish(self, success: bool, out_of_bounds: bool) -> Episode:
        scenario, goal = self.scenario, np.array(self.scenario.goal_position)
        corners, shortest = shortest_path(scenario, objects=self.objects, inflation=self.inflation)
        pushed, tool = (np.array(self.poses[key]) for key in _POSES)
        contacts, contacts_at_end = np.hsplit(np.array(self.flags), 2)
        metrics = episode_metrics(
            object_position=pushed[:, :2],
            ee_position=tool[:, :2],
            goal_position=goal,
            reward=np.array(self.rewards),
            contacts=contacts,
            contacts_at_end=contacts_at_end,
            control_freq=self.control_freq,
            success=success,
            out_of_bounds=out_of_bounds,
            shortest_length=shortest,
            final_yaw_error=self.yaw_error,
        )
        start = float(np.linalg.norm(pushed[0, :2] - goal))
        further: dict[str, Any] = {
            "path_share": path_share(success, start, metrics.final_distance),
            "side_changes": side_changes(pushed[1:], tool[1:, :2], contacts_at_end[:, 0]),
        }
        obstacle_pose = np.stack(self.obstacles) if self.obstacles else None
        if obstacle_pose is not None:
            length = metrics.path_length - metrics.final_distance
            further |= obstacle_metrics(
                scenario.dynamics.mass, length, obstacle_pose.astype(np.float64)
            )
        trajectory = Trajectory(
            object_pose=pushed.astype(np.float32),
            ee_pose=tool.astype(np.float32),
            contacts=contacts,
            planned_path=self.path if self.path is not None else corners.astype(np.float32),
            target=np.array(self.targets, dtype=np.float32).reshape(-1, 2),
            obstacle_pose=obstacle_pose,
        )
        return Episode(
            number=self.number,
            scenario=scenario,
            metrics=replace(metrics, **further),
            trajectory=trajectory,
        )


@torch.no_grad()
def run_episodes(
    env: EnvBase,
    policy: Policy,
    episodes: Iterable[tuple[int, Scenario]],
    *,
    inflation: Circle = "circumscribed",
    path_key: NestedKey | None = None,
    target_key: NestedKey | None = None,
    exploration: ExplorationType = ExplorationType.DETERMINISTIC,
    on_step: Callable[[int, int], Any] | None = None,
) -> Iterator[Episode]:
    """Run each episode once; a scene that is free immediately takes the next one.

    Args:
        env: A `PushEnv`, or one with any transforms on top, whose `reset` takes `scenarios`.
            Your own objects are looked up in its `pushed_objects`.
        policy: Acts on what `env` emits. What it writes under `next` is carried over to the next
            step; `InitTracker` or `TensorDictPrimer` in `env` tell it where an episode begins.
        episodes: Number and start of each.
        inflation: Circle of the object by whose radius obstacles are inflated for the shortest path,
            see `EpisodeConditions`.
        path_key: Key of the planned path, `[B, n, 2]` [m], in what `env.step` returns, for pictures.
            Keys under `"next"` belong to the end of the step, or to a policy's state.
        target_key: The same for the sub-goal on which the policy acts, `[B, 2]` [m].
        exploration: Exploration type of a stochastic policy.
        on_step: Called with scene and episode number after each of its steps.

    Yields:
        Each episode as it ends, and therefore not in order.

    Raises:
        KeyError: If `path_key` or `target_key` is not written, or `env` does not emit what is
            measured.
        TypeError: If the policy returns no tensordict with an action.
        ValueError: If the environment's workspace is not that of the evaluation sets.
    """
    _check_env(env)
    # Those of a `PushEnv`, transforms on top or not; its defaults for another environment.
    begin = partial(
        _Log,
        inflation=inflation,
        objects=getattr(env, "pushed_objects", None),
        control_freq=float(getattr(getattr(env, "simulation", None), "control_freq", 15)),
    )
    queue = iter(episodes)
    first = list(islice(queue, env.batch_size[0]))
    if not first:
        return
    spare = [first[-1]] * (env.batch_size[0] - len(first))  # a first reset is of all scenes
    td = _reset(env, None, first + spare)
    logs: list[_Log | None] = [
        *(begin(number, scenario, td, i) for i, (number, scenario) in enumerate(first)),
        *(None for _ in spare),
    ]
    while any(logs):
        with set_exploration_type(exploration):
            td = _check_action(policy(td))
        idle = [i for i, log in enumerate(logs) if log is None]
        if idle:
            action = td["action"].clone()  # the policy may hold on to its own tensor
            action[idle] = 0.0  # their steps are not recorded
            td["action"] = action
        td = env.step(td)
        ended = _record(td, logs, path_key, target_key, on_step)
        td = step_mdp(td)
        for row, episode in ended:
            logs[row] = None
            yield episode
        refill = list(zip((row for row, _ in ended), islice(queue, len(ended)), strict=False))
        if refill:
            td = _restart(env, td, logs, refill, begin)


def _check_action(td: Any) -> TensorDictBase:
    """The tensordict that a policy returned, if it has an action."""
    if not isinstance(td, TensorDictBase) or td.get("action", None) is None:
        got = sorted(map(str, td.keys())) if isinstance(td, TensorDictBase) else type(td).__name__
        raise TypeError(
            f"run_episodes: policy must return the tensordict with 'action', got {got}."
        )
    return td


def _check_env(env: EnvBase) -> None:
    emitted = set(env.full_observation_spec.keys(True, True))
    emitted |= set(env.full_done_spec.keys(True, True))
    missing = [key for key in (*_POSES, *_FLAGS, *_ENDS) if key not in emitted]
    if missing:
        raise KeyError(
            f"run_episodes: the environment must emit {missing}, which a transform may have "
            f"dropped; there is {sorted(map(str, emitted))}."
        )
    bounds = getattr(env, "bounds", None)
    if bounds is not None and bounds != WORKSPACE.bounds():  # of every shortest path
        raise ValueError(
            "run_episodes: the environment must have the evaluation sets' workspace, low "
            f"{WORKSPACE.low} and high {WORKSPACE.high}; its episodes end outside of {bounds}."
        )


def _reset(
    env: EnvBase, td: TensorDictBase | None, episodes: list[tuple[int, Scenario]]
) -> TensorDictBase:
    """Begin episodes; an error says which numbers they have."""
    try:
        return env.reset(td, scenarios=[scenario for _, scenario in episodes])
    except ValueError as error:
        numbers = list(dict.fromkeys(number for number, _ in episodes))
        raise ValueError(f"{error} The scenarios are the episodes {numbers}.") from error


def _restart(
    env: EnvBase,
    td: TensorDictBase,
    logs: list[_Log | None],
    refill: list[tuple[int, tuple[int, Scenario]]],
    begin: Callable[[int, Scenario, TensorDictBase, int], _Log],
) -> TensorDictBase:
    """Begin episodes in the scenes of `refill`, pairs of a scene and its next episode."""
    refill = sorted(refill, key=lambda item: item[0])
    mask = torch.zeros(len(logs), 1, dtype=torch.bool, device=td.device)
    mask[[row for row, _ in refill]] = True
    td["_reset"] = mask
    td = _reset(env, td, [episode for _, episode in refill])
    td.pop("_reset", None)
    for row, (number, scenario) in refill:
        logs[row] = begin(number, scenario, td, row)
    return td


def _record(
    td: TensorDictBase,
    logs: list[_Log | None],
    path_key: NestedKey | None,
    target_key: NestedKey | None,
    on_step: Callable[[int, int], Any] | None,
) -> list[tuple[int, Episode]]:
    """Note a step of all running episodes; returns scene and episode of those that ended."""
    after = td["next"]
    poses = {key: after[key].tolist() for key in _POSES}
    flags = torch.cat([after[key] for key in _FLAGS], -1).tolist()
    ends = torch.cat([after[key] for key in _ENDS], -1).tolist()
    rewards = after["reward"].reshape(len(logs)).tolist()
    targets = read_key(td, target_key).tolist() if target_key is not None else None
    errors = after["pose_error"].tolist() if "pose_error" in after.keys() else None
    obstacles = after.get(_OBSTACLES, None)
    ended = []
    for i, log in enumerate(logs):
        if log is None:
            continue
        if path_key is not None and log.path is None:
            log.path = read_key(td, path_key)[i].cpu().numpy().astype(np.float32)
        for key in _POSES:
            log.poses[key].append(poses[key][i])
        log.flags.append(flags[i])
        log.rewards.append(rewards[i])
        if targets is not None:
            log.targets.append(targets[i])
        if obstacles is not None:
            log.obstacles.append(log.obstacles_of(obstacles[i]))
        if errors is not None:
            log.yaw_error = abs(errors[i][1])
        if on_step is not None:
            on_step(i, log.number)
        success, outside, done = ends[i]
        if done:
            ended.append((i, log.finish(success, outside)))
    return ended
