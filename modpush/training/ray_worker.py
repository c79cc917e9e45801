"""Training scenes on a Ray cluster, through TorchRL's collectors."""

import os
import sys
import threading
import time
import warnings
from collections import OrderedDict
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent import futures
from contextlib import ExitStack
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from tensordict import TensorDict, TensorDictBase
from torchrl.collectors import BaseCollector, Collector
from torchrl.collectors.weight_update import RayWeightUpdater

from modpush._ray import ray_session
from modpush.mdp.curriculum import Curriculum
from modpush.training.config import TrainConfig
from modpush.training.rollout import Outcome, Rollout, WorkerSpecs
from modpush.training.scene_worker import EnvFactory, SceneWorker
from modpush.training.worker import CollectionEndedError, Worker

__all__ = ["RayWorker", "SceneCollector"]

_RESTARTS = 10
"""How often Ray begins an actor again that has ended."""
_HEAD_SILENT = 30.0
"""Seconds without an answer after which the cluster's head counts as gone. Ray itself ends the whole
process, without a chance to save anything, after 60."""
_CHECK_EVERY = 2.0
_TOLD_AFTER = 60.0
"""Seconds after which it is said that collectors are still waiting for CPUs."""


class _NotedCurriculum(Curriculum):
    """A curriculum that also notes which episodes it was told of, for the one at the learner."""

    outcomes: list[Outcome]

    def record(self, success: bool, scene: str, *, evaluated: bool = True) -> None:
        """Note the episode, then do as `Curriculum.record` does."""
        self.outcomes.append(Outcome(self.level, success, scene, evaluated))
        super().record(success, scene, evaluated=evaluated)


class SceneCollector(BaseCollector):
    """The collector that TorchRL's `RayCollector` runs in an actor: a `SceneWorker` and its scenes.

    Args:
        create_env_fn: Makes the `SceneWorker`, in a list of one.
        worker_idx: Index of this collector.
        rollout_length: Steps of each scene in a batch.
        **unused: Arguments of TorchRL's collectors that ask for nothing here.
    """

    total_frames = -1  # without end; TorchRL asks for it

    def __init__(
        self,
        create_env_fn: Sequence[Callable[..., SceneWorker]],
        *,
        worker_idx: int = 0,
        rollout_length: int,
        **unused: Any,
    ) -> None:
        super().__init__()
        torch.set_num_threads(1)  # an actor has one CPU
        self.worker = create_env_fn[0](make_curriculum=_NotedCurriculum)
        self._outcomes: list[Outcome] = []
        curriculum = self.worker.curriculum
        assert isinstance(curriculum, _NotedCurriculum)
        curriculum.outcomes = self._outcomes
        self._index, self._length, self._version = worker_idx, rollout_length, 0
        self._weights: dict[str, NDArray] | None = None
        self._begins = self._begun = False

    def __bool__(self) -> bool:
        """True. Ray asks this where the constructor fails, and TorchRL's own answer is an error."""
        return True

    def specs(self) -> WorkerSpecs:
        """What the learner has to know of the environment."""
        return self.worker.specs()

    def begin(self, seed: int) -> None:
        """Begin new episodes in all scenes, drawn from a seed."""
        self.worker.restart(seed)
        self._begins = self._begun = True

    def follow(self, curriculum: Mapping[str, Any], version: int) -> None:
        """Take over the learner's curriculum, and the number that the next batch is told by."""
        self.worker.set_state(dict(curriculum))
        self._version = version

    def update_policy_weights_(
        self, policy_or_weights: Any = None, *, policy_weights: TensorDictBase, **unused: Any
    ) -> None:
        """Take over the actor's weights, from TorchRL's `RayWeightUpdater`."""
        self._weights = {name: value.clone().numpy() for name, value in policy_weights.items()}

    def next(self) -> Rollout:
        """The next batch."""
        if not self._begun:  # Ray has begun this actor again; the same episodes must not come twice
            entropy = [self._index, os.getpid(), time.time_ns()]
            self.begin(_seed_of(entropy))
        self._outcomes.clear()
        rollout = self.worker.collect(self._length, self._weights)
        self.worker.forget_history()  # it is never asked for here, and would grow to the run's end
        begins, self._begins = self._begins, False
        return replace(
            rollout,
            source=self._index,
            begins=begins,
            version=self._version,
            outcomes=list(self._outcomes),
        )

    def evaluate(self, weights: dict[str, NDArray]) -> list[dict[str, Any]]:
        """Run the held-out episodes, see `SceneWorker.evaluate`."""
        return self.worker.evaluate(weights)

    def iterator(self) -> Iterator[Rollout]:
        """Batches without end."""
        while True:
            yield self.next()

    def shutdown(self, timeout: float | None = None, **unused: Any) -> None:
        """Free the simulators."""
        self.worker.close()

    def set_seed(self, seed: int, static_seed: bool = False) -> int:
        """Begin new episodes drawn from a seed; returns the next collector's."""
        self.begin(seed)
        return seed if static_seed else seed + 1

    def state_dict(self) -> OrderedDict[str, Any]:
        """The curriculum's state."""
        return OrderedDict(self.worker.get_state())

    def load_state_dict(self, state_dict: Mapping[str, Any], **unused: Any) -> None:
        """Inverse of `state_dict`."""
        self.worker.set_state(dict(state_dict))


class _Scenes:
    """All collectors of a run, with the methods of one `SceneWorker`.

    Whichever collector is done first gives the next rollout, and goes on when the one after is asked
    for, with the weights and the curriculum of then.
    """

    def __init__(
        self, ray: Any, config: TrainConfig, parts: Mapping[str, Any], make_env: EnvFactory
    ) -> None:
        self._ray = ray
        self._curriculum = Curriculum(config.curriculum, warm_up=config.warm_up)
        self._updater = RayWeightUpdater(TensorDict(), [None] * config.num_collectors)
        self.collector = Collector(
            [partial(SceneWorker, config, parts, make_env)] * config.num_collectors,
            backend="ray",
            num_collectors=config.num_collectors,
            sync=False,
            frames_per_batch=config.rollout_length * config.env.num_envs,
            total_frames=sys.maxsize,
            weight_updater=self._updater,
            backend_options={
                "collector_class": SceneCollector,
                "collector_kwargs": [
                    {"rollout_length": config.rollout_length} for _ in range(config.num_collectors)
                ],
                "remote_configs": {
                    "num_cpus": 1,
                    "max_restarts": _RESTARTS,
                    "max_task_retries": _RESTARTS,
                },
            },
        )
        self._updater.remote_collectors = self.collector.remote_collectors
        self._iterator: Iterator[Rollout] | None = None
        self._last = 0
        self._version = 0

    def specs(self) -> WorkerSpecs:
        began, asked = time.monotonic(), self.collector.remote_collectors[0].specs.remote()
        while not self._ray.wait([asked], timeout=_TOLD_AFTER)[0]:
            free, cpus = (
                resources.get("CPU", 0)
                for resources in (self._ray.available_resources(), self._ray.cluster_resources())
            )
            seconds = time.monotonic() - began
            warnings.warn(
                f"Trainer: collector='ray': no collector has begun for {seconds:.0f} s. Each takes a "
                f"CPU; of Ray's {cpus:g}, {free:g} are free.",
                stacklevel=2,
            )
        specs: WorkerSpecs = self._ray.get(asked)
        return specs

    def restart(self, seed: int) -> None:
        if self._iterator is None:  # once begun, the scenes are never interrupted
            for i, collector in enumerate(self.collector.remote_collectors):
                collector.begin.remote(_seed_of([seed, i]))

    def collect(self, steps: int, weights: dict[str, NDArray] | None) -> Rollout:
        every = range(len(self.collector.remote_collectors))
        targets = every if self._iterator is None else [self._last]
        self._version += 1
        for i in targets:
            remote = self.collector.remote_collectors[i]
            remote.follow.remote(self._curriculum.state_dict(), self._version)
        if weights is not None:
            arrays = {name: torch.from_numpy(value) for name, value in weights.items()}
            self._updater.policy_weights = TensorDict(arrays)
            self.collector.update_policy_weights_(worker_ids=list(targets))
        if self._iterator is None:
            self._iterator = iter(self.collector)
        rollout = next(self._iterator)
        self._last = rollout.source
        for outcome in rollout.outcomes:
            if outcome.level == self._curriculum.level:
                self._curriculum.record(outcome.success, outcome.scene, evaluated=outcome.evaluated)
        self._curriculum.count_steps(len(rollout.transitions["action"]))
        # What Ray gives lies in memory that may not be written to, which torch does not know of.
        return replace(
            rollout,
            transitions={key: value.copy() for key, value in rollout.transitions.items()},
            last_observation=rollout.last_observation.copy(),
            level=self._curriculum.level,
            success_by_family=self._curriculum.scene_success_rates,
            behind=self._version - rollout.version,
        )

    def history(self) -> None:
        return None

    def evaluate(self, weights: dict[str, NDArray]) -> list[dict[str, Any]]:
        idle = self.collector.remote_collectors[self._last]
        rows: list[dict[str, Any]] = self._ray.get(idle.evaluate.remote(weights))
        return rows

    def get_state(self) -> dict[str, Any]:
        return self._curriculum.state_dict()

    def set_state(self, state: dict[str, Any]) -> None:
        self._curriculum.load_state_dict(state)


class RayWorker(Worker):
    """Has the scenes act in collectors on a Ray cluster, each an actor with a CPU of its own.

    A collector that ends is begun again by Ray, with new episodes, and collects anew what it had not
    given yet; so that each rollout is given once. That first one is of the actions from before the first
    update, since the policy comes with what is asked for next.

    Args:
        config: The run's configuration, with `num_collectors`.
        parts: Parts given as objects, see `Trainer`; pickled.
        make_env: Makes the environment; pickled.

    Raises:
        MissingExtraError: If Ray is not installed.
        RuntimeError: If there is no connection to Ray, or it has fewer CPUs than collectors.
        CollectionEndedError: When a result is asked for, if the cluster's head does not answer or a
            collector has ended too often.
    """

    def __init__(self, config: TrainConfig, parts: Mapping[str, Any], make_env: EnvFactory) -> None:
        self._stack = ExitStack()
        self._ray = self._stack.enter_context(
            ray_session("Trainer: collector='ray'", config.num_collectors)
        )
        self._closed = threading.Event()
        self._asked: float | None = None  # when the head was first asked what it has not answered
        try:
            self._scenes = _Scenes(self._ray, config, parts, make_env)
        except BaseException:
            self._stack.close()
            raise
        self._result: futures.Future[Any] = futures.Future()
        self._asks_collectors = False
        threading.Thread(target=self._listen, daemon=True).start()

    def _listen(self) -> None:
        """Ask the head for an answer every now and then, and note since when there is none."""
        while not self._closed.wait(_CHECK_EVERY):
            self._asked = self._asked or time.monotonic()
            try:
                self._ray.nodes()
            except Exception:  # what Ray raises here differs with what went wrong
                continue
            self._asked = None

    @property
    def head_is_silent(self) -> bool:
        """Whether the cluster's head has left a question unanswered for half a minute."""
        asked = self._asked
        return asked is not None and time.monotonic() - asked > _HEAD_SILENT

    def _check_head(self) -> None:
        if self.head_is_silent:
            raise ConnectionError("the cluster's head does not answer")

    def _send(self, method: Callable[..., Any], arguments: tuple[Any, ...]) -> None:
        *args, kwargs = arguments
        self._asks_collectors = method.__name__ in ("specs", "collect", "evaluate")
        call = partial(getattr(self._scenes, method.__name__), *args, **kwargs)
        self._result = futures.Future()
        # Not a pool's: its threads are joined at exit, and this one may wait for a cluster that is gone.
        threading.Thread(target=_answer, args=(self._result, call), daemon=True).start()

    def _receive(self) -> Any:
        exceptions = self._ray.exceptions
        try:
            while not futures.wait([self._result], timeout=_CHECK_EVERY).done:
                self._check_head()
            # For half a minute collectors may go on without it.
            if self._asks_collectors:
                self._check_head()
            return self._result.result()
        except exceptions.RayTaskError as error:
            self._outstanding = False
            raise RuntimeError(f"Trainer: a collector failed:\n{error}") from error
        except (exceptions.RayError, ConnectionError) as error:
            self._outstanding = False
            raise CollectionEndedError(
                f"Trainer: collector='ray': the collectors are gone: {error}"
            ) from error

    def close(self) -> None:
        """End the collectors, and the connection to Ray if it was made here."""
        if self._closed.is_set():
            return
        self._closed.set()
        if self.head_is_silent:
            # Ray would tell the head of an error before it is printed, and wait for an answer until
            # it ends the process.
            sys.excepthook = sys.__excepthook__
            return
        self._scenes.collector.shutdown(timeout=1.0)
        self._stack.close()


def _answer(result: futures.Future[Any], call: Callable[[], Any]) -> None:
    try:
        result.set_result(call())
    except BaseException as error:
        result.set_exception(error)


def _seed_of(entropy: Sequence[int]) -> int:
    return int(np.random.SeedSequence(entropy).generate_state(1)[0])
