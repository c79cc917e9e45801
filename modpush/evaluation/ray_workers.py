"""Episodes of an evaluation set on the machines of a Ray cluster."""

import math
from collections.abc import Callable, Iterator, Sequence
from typing import TYPE_CHECKING, Any

import torch
from torchrl.envs import EnvBase

from modpush._ray import ray_session
from modpush.envs.scenes.scenario import Scenario
from modpush.evaluation.episodes import Episode, Policy, run_episodes

if TYPE_CHECKING:
    from modpush.evaluation.runner import EvaluationConfig

__all__ = ["run_with_ray"]

_SHARES = 4
"""Parts that an actor's episodes are divided into, so that no actor waits long for the others."""
_RESTARTS = 3
"""How often an actor that ends is begun again; what it was running is run again."""


class _Runner:
    """Runs episodes in an environment of its own, in an actor's process."""

    def __init__(
        self,
        make_env: Callable[[int], EnvBase],
        policy: Policy,
        config: "EvaluationConfig",
        options: dict[str, Any],
    ) -> None:
        torch.set_num_threads(1)  # an actor has one CPU
        self._env, self._policy = make_env(config.num_envs), policy
        self._seed, self._options = config.seed, options

    def run(self, episodes: Sequence[tuple[int, Scenario]]) -> list[Episode]:
        """Run episodes to their end."""
        torch.manual_seed(self._seed)
        return list(run_episodes(self._env, self._policy, episodes, **self._options))


def run_with_ray(
    make_env: Callable[[int], EnvBase],
    policy: Policy,
    episodes: Sequence[tuple[int, Scenario]],
    config: "EvaluationConfig",
    options: dict[str, Any],
) -> Iterator[Episode]:
    """Run episodes in a pool of actors, one for each CPU that Ray has.

    An actor that ends in the middle of its work is begun again, up to three times, and runs what it was
    running again.

    Args:
        make_env: `number of scenes -> environment`.
        policy: What acts.
        episodes: Number and start of each.
        config: How episodes are run.
        options: Further arguments of `run_episodes`.

    Yields:
        Each episode once, some time after it ended.

    Raises:
        MissingExtraError: If Ray is not installed.
        RuntimeError: If there is no connection to Ray.
        ray.exceptions.RayError: If an actor fails; of an error of its own with its traceback.
    """
    with ray_session("evaluate: workers='ray'", 1) as ray:
        from ray.util import ActorPool

        cpus = int(ray.cluster_resources()["CPU"])
        size = max(config.num_envs, math.ceil(len(episodes) / (cpus * _SHARES)))
        shares = [episodes[k : k + size] for k in range(0, len(episodes), size)]
        actor = ray.remote(num_cpus=1, max_restarts=_RESTARTS, max_task_retries=_RESTARTS)(_Runner)
        shared = [ray.put(part) for part in (make_env, policy)]
        actors = [actor.remote(*shared, config, options) for _ in range(min(cpus, len(shares)))]
        try:
            for done in ActorPool(actors).map_unordered(_run_share, shares):
                yield from done
        finally:
            for one in actors:
                ray.kill(one)


def _run_share(actor: Any, share: Sequence[tuple[int, Scenario]]) -> Any:
    return actor.run.remote(share)
