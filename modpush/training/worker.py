"""What acts: scenes, exploration, curriculum and evaluation, in this process or in one of its own."""

import gc
import multiprocessing
import signal
import traceback
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
import torch
from numpy.typing import NDArray
from tensordict import NestedKey, TensorDict, TensorDictBase
from torchrl.data import Bounded, Composite
from torchrl.envs import ExplorationType, set_exploration_type

from modpush.agents import make_tqc, quantile_huber
from modpush.envs.scenes.sampling import sample_scenario
from modpush.envs.scenes.scenario import Scenario, ScenarioConfig
from modpush.evaluation import run_episodes
from modpush.mdp.curriculum import Curriculum
from modpush.mdp.push_observation import PushObservation
from modpush.recipes.paper import make_push_env
from modpush.training.config import TrainConfig

__all__ = [
    *("Chunk", "LocalWorker", "SceneWorker", "Specs", "WorkerProcess", "held_out_scenarios"),
]

_HELD_OUT_SEED = 20_221_023  # far from any that training draws with; no evaluation set has it
_STORED = ("observation", "action", ("next", "observation"), ("next", "reward"))
_FLAGS = ("done", "terminated")
_EVALUATION_SCENES = 8
StartMethod = Literal["spawn", "fork"]


@dataclass(frozen=True)
class Specs:
    """What a learner has to know of the environment that a worker steps."""

    observation: Composite
    """`full_observation_spec_unbatched`."""
    action: Bounded
    """Of one action."""
    latent: slice
    """The encoder's columns of the observation; empty without one."""


@dataclass(frozen=True)
class Chunk:
    """What the scenes did between two exchanges."""

    transitions: dict[NestedKey, NDArray]
    """`[T * B, ...]` each, scene after scene within a step. Arrays, because torch would send each
    tensor to another process through shared memory, a file handle apiece."""
    present: NDArray[np.float32]
    """The observations that the scenes are in now, `[B, n]`."""
    episodes: list[dict[str, float]]
    """Of those that ended: success, steps, return, contact, collision, greedy."""
    level: int
    """The curriculum's."""
    families: dict[str, float]
    """Success by family, of recent episodes."""


def held_out_scenarios(config: TrainConfig) -> list[Scenario]:
    """Episodes to evaluate on during training: never trained on, the same in every run.

    Difficulty and distance are those of the evaluation sets, whatever the curriculum draws.
    """
    scenes = config.curriculum.phases[-1].scenes or config.env.scene
    base = ScenarioConfig(
        pushed_object=config.env.pushed_object,
        difficulty=config.env.difficulty,
        distance=config.env.distance,
    )
    return [
        sample_scenario(
            np.random.default_rng([_HELD_OUT_SEED, n]),
            replace(base, scene=scenes[n % len(scenes)]),
            tool=config.env.tool,
        )
        for n in range(config.evaluation_episodes)
    ]


class SceneWorker:
    """Steps the training scenes with noise, and the held-out ones without.

    Args:
        config: The run's.
    """

    def __init__(self, config: TrainConfig) -> None:
        self.config = config
        self.curriculum = Curriculum(config.curriculum)
        num_envs = config.env.num_envs
        self.greedy = list(range(num_envs - config.greedy_scenes, num_envs))
        self.env = make_push_env(
            config.env,
            curriculum=self.curriculum,
            evaluated_envs=self.greedy or None,
            seed=config.seed,
        )
        agent = make_tqc(replace(config.tqc, device="cpu", execution="eager"), self.env)
        self.actor, self.explore = agent.actor, agent.exploration_policy
        self._evaluation_env: Any = None
        self._scenarios = held_out_scenarios(config)
        self._td: TensorDictBase | None = None
        self._tally = torch.zeros(num_envs, 4)  # steps, return, contact, collision so far

    def specs(self) -> Specs:
        """Of the environment."""
        columns = [t.columns for t in self.env.transform if isinstance(t, PushObservation)]
        return Specs(
            observation=self.env.full_observation_spec_unbatched,
            action=self.env.full_action_spec_unbatched["action"],
            latent=columns[0].get("latent", slice(0, 0)) if columns else slice(0, 0),
        )

    def restart(self, seed: int) -> None:
        """Begin new episodes in all scenes, drawn anew from a seed."""
        self.env.set_seed(seed)
        torch.manual_seed(seed)
        self._td = self.env.reset()
        self._tally.zero_()

    def load_policy(self, weights: dict[str, NDArray]) -> None:
        """Take over the actor's `state_dict`, as arrays."""
        state = {name: torch.from_numpy(np.array(value)) for name, value in weights.items()}
        self.actor.load_state_dict(state)

    @torch.no_grad()
    def collect(self, steps: int, weights: dict[str, NDArray] | None) -> Chunk:
        """Step every scene so many times.

        Args:
            steps: Of each scene.
            weights: The actor's; None acts at random, before there is anything to follow.
        """
        assert self._td is not None, "restart comes first"
        random = weights is None
        if weights is not None:
            self.load_policy(weights)
        td, rows, episodes = self._td, [], []
        for _ in range(steps):
            td = self.env.rand_action(td) if random else self._act(td)
            td, following = self.env.step_and_maybe_reset(td)
            rows.append(td.select(*_STORED, *(("next", flag) for flag in _FLAGS)))
            episodes += self._count(td["next"], random)
            td = following
        self._td = td
        stacked = TensorDict.stack(rows).reshape(-1)
        return Chunk(
            transitions={key: value.numpy() for key, value in stacked.items(True, True)},
            present=td["observation"].numpy().copy(),
            episodes=episodes,
            level=self.curriculum.level,
            families=self.curriculum.scene_success_rates,
        )

    def _act(self, td: TensorDictBase) -> TensorDictBase:
        with set_exploration_type(ExplorationType.RANDOM):
            td = self.explore(td)
        if self.greedy:
            mode = self.actor.get_dist(td.select("observation")[self.greedy]).deterministic_sample
            td["action"][self.greedy] = mode
        return td

    def _count(self, after: TensorDictBase, random: bool) -> list[dict[str, float]]:
        collision = after["obstacle_contact"] | after["tool_obstacle_contact"]
        contact = after["object_contact"].float()
        row = [torch.ones_like(contact), after["reward"], contact, collision.float()]
        self._tally += torch.cat(row, -1)
        ended = []
        for i in after["done"].flatten().nonzero().flatten().tolist():
            steps, total, touched, collided = self._tally[i].tolist()
            ended.append(
                {
                    "success": float(after["success"][i]),
                    "out_of_bounds": float(after["out_of_bounds"][i]),
                    "steps": steps,
                    "return": total,
                    "contact": touched / steps,
                    "collision": collided / steps,
                    "greedy": float(i in self.greedy and not random),
                }
            )
            self._tally[i] = 0.0
        return ended

    def evaluate(self, weights: dict[str, NDArray]) -> list[dict[str, Any]]:
        """Run the held-out episodes greedily; a row of metrics for each, by number."""
        self.load_policy(weights)
        if self._evaluation_env is None:
            few = min(self.config.env.num_envs, _EVALUATION_SCENES)  # each takes memory
            self._evaluation_env = make_push_env(replace(self.config.env, num_envs=few))
        episodes = run_episodes(self._evaluation_env, self.actor, enumerate(self._scenarios))
        rows = [
            {"episode": e.number, "scene": e.scenario.scene, **e.metrics.to_dict()}
            for e in episodes
        ]
        return sorted(rows, key=lambda row: row["episode"])

    def get_state(self) -> dict[str, Any]:
        """The curriculum's."""
        return self.curriculum.state_dict()

    def set_state(self, state: dict[str, Any]) -> None:
        """Inverse of `get_state`."""
        self.curriculum.load_state_dict(state)

    def close(self) -> None:
        """Free the simulators."""
        for env in (self.env, self._evaluation_env):
            if env is not None and not env.is_closed:
                env.close()


class LocalWorker:
    """A `SceneWorker` that does what it is asked when its answer is wanted: taking turns.

    Args:
        config: The run's.
    """

    def __init__(self, config: TrainConfig) -> None:
        self._worker = SceneWorker(config)
        self._asked: tuple[str, Sequence[Any]] | None = None

    def ask(self, method: str, *arguments: Any) -> None:
        """Ask for a method of `SceneWorker`; `answer` has the result."""
        assert self._asked is None, "one question at a time"
        self._asked = method, arguments

    def answer(self) -> Any:
        """The result of what was asked."""
        assert self._asked is not None, "ask first"
        (method, arguments), self._asked = self._asked, None
        return getattr(self._worker, method)(*arguments)

    @property
    def busy(self) -> bool:
        """Whether an answer is outstanding."""
        return self._asked is not None

    def call(self, method: str, *arguments: Any) -> Any:
        """Ask and wait."""
        self.ask(method, *arguments)
        return self.answer()

    def close(self) -> None:
        """Free the simulators."""
        self._worker.close()


class WorkerProcess:
    """The same in a process of its own: it works while the caller does something else.

    Args:
        config: The run's.
        start_method: `"spawn"` is always right. `"fork"` shares the libraries' memory with the
            caller, some 300 MB; it is only for a process that has made no simulator, and run nothing
            on several threads of torch or numba, since a fork copies their state without the threads.

    Raises:
        RuntimeError: In `answer`, if the worker failed; with its traceback.
    """

    def __init__(self, config: TrainConfig, start_method: StartMethod = "spawn") -> None:
        context: Any = multiprocessing.get_context(start_method)
        if start_method == "fork":
            # Numba's compiler, 50 MB that both processes would else hold, starts at the first call.
            quantile_huber(torch.zeros(1, 1, 1), torch.zeros(1, 1))
            gc.collect()
            gc.freeze()  # a collection would write to, and so copy, every page with an object on it
        self._pipe, theirs = context.Pipe()
        # A forked worker holds our end of the pipe as well, and must let go of it to hear us end.
        ours = self._pipe if start_method == "fork" else None
        self._process = context.Process(target=_serve, args=(theirs, config, ours), daemon=True)
        self._process.start()
        theirs.close()
        self._waiting = False

    def ask(self, method: str, *arguments: Any) -> None:
        """Ask for a method of `SceneWorker`; `answer` has the result."""
        assert not self._waiting, "one question at a time"
        self._pipe.send((method, arguments))
        self._waiting = True

    def answer(self) -> Any:
        """The result of what was asked; waits for it."""
        assert self._waiting, "ask first"
        try:
            failed, result = self._pipe.recv()
            self._waiting = False  # not before: an interrupt may come while it waits
        except EOFError:
            self._waiting = False
            self._process.join(5)
            raise RuntimeError(
                f"WorkerProcess: the worker ended early, exit code {self._process.exitcode}."
            ) from None
        if failed:
            raise RuntimeError(f"WorkerProcess: the worker failed:\n{result}")
        return result

    @property
    def busy(self) -> bool:
        """Whether an answer is outstanding."""
        return self._waiting

    def call(self, method: str, *arguments: Any) -> Any:
        """Ask and wait."""
        self.ask(method, *arguments)
        return self.answer()

    def close(self) -> None:
        """End the process."""
        if self._process.is_alive():
            self._process.terminate()
        self._process.join()
        self._pipe.close()


def _serve(pipe: Any, config: TrainConfig, callers_end: Any = None) -> None:
    if callers_end is not None:
        callers_end.close()
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the caller's to handle
    # The other core is the learner's. Our kernels follow torch's number; numba's own setting would
    # put torch's back to all cores.
    torch.set_num_threads(1)
    worker: SceneWorker | None = None
    while True:
        try:
            method, arguments = pipe.recv()
        except EOFError:  # the caller is gone
            return
        try:
            worker = SceneWorker(config) if worker is None else worker
            pipe.send((False, getattr(worker, method)(*arguments)))
        except Exception:
            pipe.send((True, traceback.format_exc()))
