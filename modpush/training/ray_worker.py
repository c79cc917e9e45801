"""Training scenes on a Ray cluster, through TorchRL's collectors."""

import os
import sys
import time
from collections import OrderedDict
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from tensordict import TensorDict
from torchrl.collectors import BaseCollector, Collector
from torchrl.collectors.weight_update import RayWeightUpdater

from modpush._processes import RESTARTS, ray_session
from modpush.mdp.curriculum import Curriculum
from modpush.training.config import TrainConfig
from modpush.training.scene_worker import EnvFactory, Outcome, Rollout, SceneWorker
from modpush.training.worker import CollectionEndedError, Worker


class _RecordingCurriculum(Curriculum):
    """A curriculum that also keeps the results of its episodes, for the learner's curriculum."""

    outcomes: tuple[Outcome, ...] = ()

    def record(self, success: bool, scene: str, *, evaluated: bool = True) -> None:
        self.outcomes += (Outcome(self.level, success, scene, evaluated),)
        super().record(success, scene, evaluated=evaluated)


class SceneCollector(BaseCollector):
    """The collector that TorchRL runs in an actor: a `SceneWorker`, made by `create_env_fn[0]`."""

    total_frames = -1  # without end

    def __init__(
        self, create_env_fn: Any, *, rollout_length: int, worker_idx: int = 0, **unused: Any
    ) -> None:
        super().__init__()
        torch.set_num_threads(1)  # an actor has one CPU
        self.worker: SceneWorker = create_env_fn[0](make_curriculum=_RecordingCurriculum)
        self._index, self._length, self._version = worker_idx, rollout_length, 0
        self._weights: dict[str, NDArray] | None = None
        self._begins = self._begun = False

    def __bool__(self) -> bool:
        return True  # Ray asks where the constructor fails, and TorchRL's own answer is an error

    def call(self, method: Callable[..., Any], *args: Any) -> Any:
        """Call a method of the `SceneWorker`."""
        return method(self.worker, *args)

    def follow(self, curriculum: dict[str, Any], version: int) -> None:
        """Take over the learner's curriculum, and the number by which the next batch is known."""
        self.worker.set_state(curriculum)
        self._version = version

    def update_policy_weights_(self, *unused: Any, policy_weights: Any, **options: Any) -> None:
        self._weights = {name: value.clone().numpy() for name, value in policy_weights.items()}

    def set_seed(self, seed: int, static_seed: bool = False) -> int:
        """Start new episodes in all scenes."""
        self.worker.restart(seed)
        self._begins = self._begun = True
        return seed

    def next(self) -> Rollout:
        if (
            not self._begun
        ):  # Ray has started this actor again; the same episodes must not come twice
            self.set_seed(_seed_of(self._index, os.getpid(), time.time_ns()))
        curriculum: Any = self.worker.curriculum
        curriculum.outcomes = ()
        rollout = self.worker.collect(self._length, self._weights)
        begins, self._begins = self._begins, False
        about: dict[str, Any]
        about = {"source": self._index, "begins": begins, "version": self._version}
        return replace(rollout, **about, outcomes=list(curriculum.outcomes))

    def iterator(self) -> Iterator[Rollout]:
        while True:
            yield self.next()

    def shutdown(self, *args: Any, **kwargs: Any) -> None:
        self.worker.close()

    def state_dict(self) -> OrderedDict[str, Any]:
        return OrderedDict(self.worker.get_state())

    def load_state_dict(self, state_dict: Mapping[str, Any], **unused: Any) -> None:
        self.worker.set_state(dict(state_dict))


class RayWorker(Worker):
    """Runs the scenes in `config.num_collectors` collectors on a Ray cluster, each with a CPU.

    The collector that is done first gives the next rollout; it continues when the one after is asked
    for, with the weights and the curriculum of then. A collector that ends is started again by Ray, with
    new episodes. If the cluster's head is lost, Ray ends this process after a minute: the run continues
    from its last checkpoint. `parts` and `make_env` are pickled. A RuntimeError is raised if there is no
    connection to Ray, or it has fewer CPUs than collectors, or when a collector has failed; a
    CollectionEndedError, if one has ended too often.
    """

    def __init__(self, config: TrainConfig, parts: Mapping[str, Any], make_env: EnvFactory) -> None:
        count = config.num_collectors
        self._session = ray_session("Trainer: collector='ray'", count)
        self._ray = self._session.__enter__()
        self._curriculum = Curriculum(config.curriculum, warm_up=config.warm_up)
        self._updater = RayWeightUpdater(TensorDict(), [None] * count)
        restarts = {"max_restarts": RESTARTS, "max_task_retries": RESTARTS}
        self._collector = Collector(
            [partial(SceneWorker, config, parts, make_env)] * count,
            backend="ray",
            num_collectors=count,
            sync=False,
            frames_per_batch=config.rollout_length * config.env.num_envs,
            total_frames=sys.maxsize,
            weight_updater=self._updater,
            backend_options={
                "collector_class": SceneCollector,
                "collector_kwargs": [
                    {"rollout_length": config.rollout_length} for _ in range(count)
                ],
                "remote_configs": {"num_cpus": 1, **restarts},
            },
        )
        self._actors = self._updater.remote_collectors = self._collector.remote_collectors
        self._rollouts: Iterator[Rollout] | None = None
        self._last = self._version = 0
        # TorchRL's iterator has the last collector continue and waits for the next in one call.
        self._thread, self._result = ThreadPoolExecutor(1), Future[Any]()

    def _send(self, method: Callable[..., Any], args: Any, kwargs: Any) -> None:
        own = getattr(self, f"_{method.__name__}", partial(self._ask, method))
        self._result = self._thread.submit(own, *args, **kwargs)

    def _receive(self) -> Any:
        errors = self._ray.exceptions
        try:
            return self._result.result()
        except errors.RayTaskError as error:
            raise RuntimeError(f"Trainer: a collector failed:\n{error}") from error
        except errors.RayError as error:
            raise CollectionEndedError(f"Trainer: the Ray collectors are gone: {error}") from error

    def close(self) -> None:
        """End the collectors, and the connection to Ray if it was made here."""
        self._thread.shutdown(wait=False, cancel_futures=True)
        if self._actors:
            self._actors = []
            self._collector.shutdown(timeout=1.0)
            self._session.__exit__(None, None, None)

    def _ask(self, method: Callable[..., Any], *args: Any) -> Any:
        """Have one collector's `SceneWorker` do it: `specs` and `evaluate`."""
        return self._ray.get(self._actors[self._last].call.remote(method, *args))

    def _restart(self, seed: int) -> None:
        if self._rollouts is None:  # once begun, the scenes are never interrupted
            seeds = [_seed_of(seed, i) for i in range(len(self._actors))]
            self._ray.get([a.set_seed.remote(s) for a, s in zip(self._actors, seeds, strict=True)])

    def _collect(self, steps: int, weights: dict[str, NDArray] | None) -> Rollout:
        targets = [*range(len(self._actors))] if self._rollouts is None else [self._last]
        self._version += 1
        for i in targets:
            self._actors[i].follow.remote(self._curriculum.state_dict(), self._version)
        if weights is not None:
            arrays = {name: torch.from_numpy(value) for name, value in weights.items()}
            self._updater.policy_weights = TensorDict(arrays)
            self._collector.update_policy_weights_(worker_ids=targets)
        self._rollouts = self._rollouts or iter(self._collector)
        rollout = next(self._rollouts)
        self._last = rollout.source
        for outcome in rollout.outcomes:
            if outcome.level == self._curriculum.level:
                self._curriculum.record(outcome.success, outcome.scene, evaluated=outcome.evaluated)
        self._curriculum.count_steps(len(rollout.transitions["action"]))
        return replace(  # Ray's memory may not be written to, which torch does not know
            rollout,
            transitions={key: value.copy() for key, value in rollout.transitions.items()},
            last_observation=rollout.last_observation.copy(),
            level=self._curriculum.level,
            success_by_family=self._curriculum.scene_success_rates,
            behind=self._version - rollout.version,
        )

    def _get_state(self) -> dict[str, Any]:
        return self._curriculum.state_dict()

    def _set_state(self, state: dict[str, Any]) -> None:
        self._curriculum.load_state_dict(state)


def _seed_of(*entropy: int) -> int:
    return int(np.random.SeedSequence(entropy).generate_state(1)[0])
