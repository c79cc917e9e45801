"""`Hindsight`: episodes that have ended, once more with the pose that they ended in as their goal.

Source: Andrychowicz et al. 2017, "Hindsight Experience Replay". Observations cannot be relabelled after
they were stored: axes, path, sub-goals and latent depend on the goal. Therefore the recorded episode is
played once more through the environment's own transforms, with the goal replaced.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from tensordict import NestedKey, TensorDict, TensorDictBase
from torchrl.envs import EnvBase
from torchrl.envs.utils import step_mdp

from modpush.envs.engines.base import CONTACT_KEYS, SceneSpec
from modpush.envs.engines.recorded import RecordedEngine, Recording
from modpush.envs.outcome import is_out_of_bounds, pose_errors
from modpush.envs.scenes.scenario import Scenario
from modpush.mdp.action_frame import ActionFrame
from modpush.recipes.planning import observed_keys
from modpush.training.config import TrainConfig

_STATE = ("object_pose", "ee_pose", "joint_position", *CONTACT_KEYS)
_ENVS = 16  # episodes that are played together
_GROUPS = 4  # played at once, the episodes sorted by length: a group takes as long as its longest


@dataclass(frozen=True)
class _Episode:
    """An episode with its new goal."""

    scenario: Scenario
    recording: Recording
    actions: NDArray[np.float32]
    """In the base frame, `[T, 3]`."""


class Hindsight:
    """Records the steps of a run's scenes, and gives transitions of ended episodes with other goals.

    The new goal is the last pose of the object in the workspace; the episode is cut off there, and ends
    before where the goal was met before. Episodes that meet it from the start teach nothing and are
    dropped. `stored` are the keys of a transition.
    """

    def __init__(
        self,
        config: TrainConfig,
        parts: Mapping[str, Any],
        make_env: Callable[..., EnvBase],
        stored: Sequence[NestedKey],
    ) -> None:
        self._config, self._stored = config, list(stored)
        pose_key = observed_keys(config.env.sensing)["object_pose"]
        self._frame = ActionFrame(config.env.acting_frame, object_pose_key=pose_key)
        self._workspace = config.env.scenario.bounds(0.0)
        self._engines: list[RecordedEngine] = []
        env = replace(config.env, num_envs=min(_ENVS, config.env.num_envs))
        env = replace(
            env, recovery=False, contact_filter=False
        )  # neither changes what was recorded
        # Targets of the drives are computed, and not followed: one for each control step is enough.
        env = env.with_fields(engine=self._make_engine, sim_freq=env.simulation.control_freq)
        parts = {kind: part for kind, part in parts.items() if kind != "engine"}
        self._env = make_env(env, **parts, **({"mirrored": True} if config.mirror else {}))
        self.restart()

    def _make_engine(self, spec: SceneSpec) -> RecordedEngine:
        self._engines.append(RecordedEngine(spec))
        return self._engines[-1]

    def restart(self) -> None:
        """Forget all that was recorded, after a reset of the scenes."""
        self._steps: list[list[NDArray[np.float32]]] = [
            [] for _ in range(self._config.env.num_envs)
        ]
        self._waiting: list[_Episode] = []

    def add(
        self, step: TensorDictBase, scenarios: Sequence[Scenario], yaw_tolerance: float
    ) -> None:
        """Take note of the environment's `step` in all scenes, whose episodes began from `scenarios`.

        `yaw_tolerance` is the present one of goal poses [rad].
        """
        before, after = _states(step), _states(step["next"])
        rows = torch.cat([before, after, self._frame.to_base(step)], -1).numpy()
        for steps, row in zip(self._steps, rows, strict=True):
            steps.append(row)
        for i in step["next", "done"].flatten().nonzero().flatten().tolist():
            episode = self._relabelled(np.stack(self._steps[i]), scenarios[i], yaw_tolerance)
            self._waiting += [] if episode is None else [episode]
            self._steps[i] = []

    def _relabelled(
        self, rows: NDArray[np.float32], scenario: Scenario, yaw_tolerance: float
    ) -> _Episode | None:
        """An episode with its last pose in the workspace as the goal; None if it is met at the start."""
        states, actions = np.split(rows[:, :-3], 2, axis=1), rows[:, -3:]
        state = np.concatenate([states[0][:1], states[1]])  # [T + 1, n]
        pose, ee_pose, joints, contacts = np.split(state, [3, 6, -len(CONTACT_KEYS)], axis=1)
        inside = ~is_out_of_bounds(pose[:, :2], self._workspace)
        last = int(np.flatnonzero(inside)[-1]) if inside.any() else 0
        goal = pose[last].astype(np.float64)
        simulation = self._config.env.simulation
        posed = scenario.goal_yaw is not None
        errors = pose_errors(pose[:1].astype(np.float64), goal[None], self._symmetry(scenario))
        distance, turn = np.abs(errors[0])
        if distance <= simulation.position_tolerance and (not posed or turn <= yaw_tolerance):
            return None
        x, y, yaw = goal.tolist()
        recording = Recording(
            object_pose=pose[: last + 1],
            ee_pose=ee_pose[: last + 1],
            joint_position=joints[: last + 1],
            contacts=contacts[1 : last + 1] > 0.5,
        )
        there = replace(scenario, goal_position=(x, y), goal_yaw=yaw if posed else None)
        return _Episode(there, recording, actions[:last])

    def _symmetry(self, scenario: Scenario) -> NDArray[np.float64]:
        item = self._env.pushed_objects[scenario.pushed_object]
        return np.array([1.0 if self._config.env.simulation.full_circle else item.symmetry])

    def transitions(self, yaw_tolerance: float) -> dict[NestedKey, NDArray[Any]]:
        """Arrays `[N, ...]` by key of the episodes that wait, once enough can be played together.

        They have n-step returns if the run has them.
        """
        count = len(self._engines)
        if len(self._waiting) < _GROUPS * count:
            return {}
        last = len(self._waiting) // count * count
        episodes, self._waiting = self._waiting[:last], self._waiting[last:]
        episodes.sort(key=lambda episode: len(episode.actions))
        self._env.base_env.yaw_tolerance = yaw_tolerance
        found: list[TensorDictBase] = []
        for first in range(0, last, count):
            found += self._play(episodes[first : first + count])
        rows: Any = torch.cat(found)
        return {key: value.numpy() for key, value in rows.items(True, True)}

    def _play(self, episodes: Sequence[_Episode]) -> list[TensorDictBase]:
        """Play one episode in each scene; returns the transitions `[T]` of each."""
        for engine, episode in zip(self._engines, episodes, strict=True):
            engine.recording = episode.recording
        td = self._env.reset(scenarios=[episode.scenario for episode in episodes])
        steps = []
        for t in range(max(len(episode.actions) for episode in episodes)):
            actions = [e.actions[min(t, len(e.actions) - 1)] for e in episodes]
            td = self._frame.to_agent(td.set("action", torch.from_numpy(np.stack(actions))))
            td = self._env.step(td)
            steps.append(td.select(*self._stored))
            td = step_mdp(td)
        rows = TensorDict.stack(steps, 1)
        replay, gamma = self._config.replay, self._config.tqc.gamma
        played = []
        for row, episode in zip(rows, episodes, strict=True):
            done = row["next", "done"].flatten().nonzero().flatten().tolist()
            length = min([n + 1 for n in done] + [len(episode.actions)])
            played.append(n_step_returns(row[:length], replay.n_steps, gamma))
        return played

    def close(self) -> None:
        """Free the environment."""
        self._env.close(raise_if_closed=False)


def n_step_returns(episode: TensorDictBase, n_steps: int, gamma: float) -> TensorDictBase:
    """Single transitions of a whole episode `[T]` with n-step returns, as `NStepTransform` gives them.

    Fewer rewards are summed where the episode ends.
    """
    if n_steps == 1:
        return episode
    length, reward = len(episode), episode["next", "reward"]
    total = reward.clone()
    for k in range(1, min(n_steps, length)):
        total[: length - k] += gamma**k * reward[k:]
    first = torch.arange(length)
    last = (first + n_steps - 1).clamp_max(length - 1)
    result = episode.clone(recurse=False)
    result["next"] = episode["next"][last].set("reward", total)
    result["steps_to_next_obs"] = last - first + 1
    return result


def _states(td: TensorDictBase) -> torch.Tensor:
    """The entries of a `Recording` in a step, `[B, n]` float32."""
    return torch.cat([td[key].float() for key in _STATE], -1)
