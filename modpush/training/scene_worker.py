"""The side of training that acts: scenes, exploration, curriculum and evaluation; and its rollouts."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from tensordict import NestedKey, TensorDict, TensorDictBase
from torchrl.data import Bounded, Composite
from torchrl.envs import EnvBase, ExplorationType, set_exploration_type

from modpush._precision import networks_in, processor_precision
from modpush.agents.scripted import ScriptedPusher
from modpush.agents.tqc.build import make_tqc
from modpush.mdp.action_frame import ActionFrame
from modpush.mdp.curriculum import Curriculum
from modpush.mdp.push_observation import PushObservation
from modpush.recipes.config import END_TO_END, PushEnvConfig
from modpush.recipes.fingerprint import environment_fingerprint
from modpush.recipes.make_env import env_parts, make_push_env
from modpush.recipes.planning import observed_keys
from modpush.training.config import TrainConfig, learner_parts
from modpush.training.held_out import EvaluationProgress, HeldOutEpisodes
from modpush.training.hindsight import Hindsight


@dataclass(frozen=True)
class WorkerSpecs:
    """Specs and fingerprint of the environment that a worker steps."""

    observation: Composite  # The environment's `full_observation_spec_unbatched`
    action: Bounded  # Spec of one action, `[A]`
    # The columns of each entry of the observation, by name; empty without a `PushObservation`
    columns: dict[str, slice]
    fingerprint: dict[str, Any]  # Fingerprint, see `modpush.recipes.environment_fingerprint`


@dataclass(frozen=True)
class Outcome:
    """Result of an episode, for the curriculum."""

    level: int  # The curriculum's level that the episode is of
    success: bool  # True if the object reached the goal
    scene: str  # Name of the scene
    evaluated: bool  # True if the episode counts towards the next stage


@dataclass(frozen=True)
class Rollout:
    """`T` steps of `B` scenes between two exchanges with the learner."""

    # Arrays `[T * B, ...]` by key, scene after scene within a step. They are arrays because torch
    # would send each tensor to another process through shared memory, with a file handle each
    transitions: dict[NestedKey, NDArray]
    last_observation: NDArray[np.float32]  # Observations that the scenes are in now, `[B, n]`
    # Metrics of the episodes that ended: success, steps, return, contact, collision, greedy
    episodes: list[dict[str, float]]
    level: int  # The curriculum's level
    success_by_family: dict[str, float]  # Success of recent episodes, by scene family
    # Further transitions `[N, ...]`, of episodes with another goal, see `Hindsight`
    hindsight: dict[NestedKey, NDArray] = field(default_factory=dict)
    source: int = 0  # Number of the collector
    # True if the scenes were reset before it, without the end of an episode in the data
    begins: bool = False
    # Number of the weights that it was collected with, counted from 1 as they were sent
    version: int = 0
    behind: int = 0  # Number of later weights that were sent to other collectors until then
    # Results for the collector's own curriculum; empty where it is the only one
    outcomes: list[Outcome] = field(default_factory=list)


_NOISE = 0.2
"""Standard deviation of the noise, in units of half the action's range."""


class FirstActions:
    """`ScriptedPusher` along the planner's sub-goals, with noise, in the agent's axes."""

    def __init__(self, config: PushEnvConfig) -> None:
        self._pusher = ScriptedPusher(target_key="subgoal")
        pose_key = observed_keys(config.sensing)["object_pose"]
        self._frame = ActionFrame(config.acting_frame, object_pose_key=pose_key)

    def __call__(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Write the action, `[B, 3]` in [-1, 1]."""
        tensordict = self._frame.to_agent(self._pusher(tensordict))
        action = tensordict["action"]
        noisy = action + _NOISE * torch.randn_like(action)
        return tensordict.set("action", noisy.clamp(-1.0, 1.0))


EnvFactory = Callable[..., EnvBase]
"""`(PushEnvConfig, *, curriculum=None, evaluated_envs=None, seed=None, **parts) -> environment`, as
`make_push_env` is. It must emit `observation`, `reward`, `success`, `out_of_bounds` and the contact
keys of `PushEnv`."""

_FLAGS = ("done", "terminated")


class SceneWorker:
    """Steps the training scenes with noise, and the held-out episodes without.

    `progress` is that of the held-out episodes, which it may stop.
    """

    def __init__(
        self,
        config: TrainConfig,
        parts: Mapping[str, Any] | None = None,
        make_env: EnvFactory = make_push_env,
        *,
        make_curriculum: Callable[..., Curriculum] = Curriculum,
        progress: EvaluationProgress | None = None,
    ) -> None:
        self.config, parts = config, parts or {}
        self._first_policy = FirstActions(config.env) if config.warm_up else None
        self.curriculum = make_curriculum(config.curriculum, warm_up=config.warm_up)
        num_envs = config.env.num_envs
        self.greedy_envs = list(range(num_envs - config.greedy_envs, num_envs))
        self.env = make_env(
            replace(config.env, recovery=False),
            curriculum=self.curriculum,
            evaluated_envs=self.greedy_envs or None,
            seed=config.seed,
            **({"mirrored": True} if config.mirror else {}),
            **env_parts(config.env, parts),
        )
        agent = make_tqc(
            replace(config.tqc, device="cpu", execution="eager"),
            self.env,
            **learner_parts(config, parts),
        )
        self.actor, self.explore = agent.actor, agent.exploration_policy
        self._precision = agent.update.precision
        if config.collector == "ray" and processor_precision() == "float32":
            self._precision = "float32"  # the learner's machine may have another processor
        self._held_out = HeldOutEpisodes(config, parts, make_env, progress)
        observed = (
            "observation",
            *([config.tqc.image_key] if config.env.encoder == END_TO_END else []),
            *(["mirrored_observation"] if config.mirror else []),
        )
        self._stored: list[NestedKey] = [
            *observed,
            "action",
            ("next", "reward"),
            *(("next", key) for key in (*observed, *_FLAGS)),
        ]
        self._hindsight: Hindsight | None = None
        if config.hindsight:
            own = env_parts(config.env, parts)
            self._hindsight = Hindsight(config, own, make_env, self._stored)
        self._td: TensorDictBase | None = None
        self._sums = torch.zeros(num_envs, 4)  # steps, return, contact, collision of the episode

    def specs(self) -> WorkerSpecs:
        """Specs and fingerprint of the environment, for the learner."""
        columns = [t.columns for t in self.env.transform if isinstance(t, PushObservation)]
        return WorkerSpecs(
            observation=self.env.full_observation_spec_unbatched,
            action=self.env.full_action_spec_unbatched["action"],
            columns=columns[0] if columns else {},
            fingerprint=environment_fingerprint(self.env),
        )

    def restart(self, seed: int) -> None:
        """Begin new episodes in all scenes, drawn from a seed."""
        self.env.set_seed(seed)
        torch.manual_seed(seed)
        self._td = self.env.reset()
        self._sums.zero_()
        if self._hindsight is not None:
            self._hindsight.restart()

    def load_policy(self, weights: dict[str, NDArray]) -> None:
        """Take over the actor's `state_dict`, given as arrays."""
        state = {name: torch.from_numpy(np.array(value)) for name, value in weights.items()}
        self.actor.load_state_dict(state)

    @torch.no_grad()
    def collect(self, steps: int, weights: dict[str, NDArray] | None) -> Rollout:
        """Step every scene, with the actor's weights; None for the policy `TrainConfig.first_actions`.

        Raises:
            RuntimeError: If `restart` has not been called.
        """
        if self._td is None:
            raise RuntimeError("SceneWorker.collect: call restart first.")
        random = weights is None
        if weights is not None:
            self.load_policy(weights)
        td, rows, episodes = self._td, [], []
        hindsight: dict[NestedKey, NDArray] = {}
        with networks_in(self._precision, fixed_weights=True):
            for _ in range(steps):
                td = self._first_action(td) if random else self._act(td)
                scenarios = self._simulator.scenarios if self._hindsight is not None else []
                td, following = self.env.step_and_maybe_reset(td)
                if self._hindsight is not None:
                    self._hindsight.add(td, scenarios, self._simulator.yaw_tolerance)
                rows.append(td.select(*self._stored))
                episodes += self._ended_episodes(td["next"], random)
                td = following
            if self._hindsight is not None:
                hindsight = self._hindsight.transitions(self._simulator.yaw_tolerance)
        self._td = td
        stacked = TensorDict.stack(rows).reshape(-1)
        return Rollout(
            transitions={key: value.numpy() for key, value in stacked.items(True, True)},
            last_observation=td["observation"].numpy().copy(),
            episodes=episodes,
            level=self.curriculum.level,
            success_by_family=self.curriculum.scene_success_rates,
            hindsight=hindsight,
        )

    @property
    def _simulator(self) -> Any:
        """The `PushEnv` without the transforms."""
        return self.env.base_env

    def _first_action(self, td: TensorDictBase) -> TensorDictBase:
        return self.env.rand_action(td) if self._first_policy is None else self._first_policy(td)

    def _act(self, td: TensorDictBase) -> TensorDictBase:
        with set_exploration_type(ExplorationType.RANDOM):
            td = self.explore(td)
        if self.greedy_envs:
            # Of the parameters that the policy has just written, without calling it again.
            dist = self.actor.build_dist_from_params(td)
            td["action"][self.greedy_envs] = dist.deterministic_sample[self.greedy_envs]
        return td

    def _ended_episodes(self, after: TensorDictBase, random: bool) -> list[dict[str, float]]:
        """Add a step to the episodes' sums; returns the metrics of those that ended with it."""
        collision = after["obstacle_contact"] | after["tool_obstacle_contact"]
        contact = after["object_contact"].float()
        row = [torch.ones_like(contact), after["reward"], contact, collision.float()]
        self._sums += torch.cat(row, -1)
        ended = []
        for i in after["done"].flatten().nonzero().flatten().tolist():
            steps, total, in_contact, in_collision = self._sums[i].tolist()
            ended.append(
                {
                    "success": float(after["success"][i]),
                    "out_of_bounds": float(after["out_of_bounds"][i]),
                    "steps": steps,
                    "return": total,
                    "contact": in_contact / steps,
                    "collision": in_collision / steps,
                    "greedy": float(i in self.greedy_envs and not random),
                }
            )
            self._sums[i] = 0.0
        return ended

    def evaluate(
        self, weights: dict[str, NDArray], numbers: Iterable[int] | None = None
    ) -> list[dict[str, Any]]:
        """Run held-out episodes greedily with the weights of an actor; a row of metrics for each."""
        self.load_policy(weights)
        return self._held_out.run(self.actor, numbers)

    def get_state(self) -> dict[str, Any]:
        """The curriculum's state."""
        return self.curriculum.state_dict()

    def set_state(self, state: dict[str, Any]) -> None:
        """Inverse of `get_state`."""
        self.curriculum.load_state_dict(state)

    def close(self) -> None:
        """Free the simulators."""
        self._held_out.close()
        if self._hindsight is not None:
            self._hindsight.close()
        if not self.env.is_closed:
            self.env.close()
