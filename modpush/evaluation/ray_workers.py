"""Episodes of an evaluation set on the machines of a Ray cluster."""

import math
from collections.abc import Callable, Iterator, Sequence
from typing import TYPE_CHECKING, Any

import torch
from torchrl.envs import EnvBase

from modpush._ray import RESTARTS, ray_session
from modpush.envs.scenes.scenario import Scenario
from modpush.evaluation.episodes import Episode, Policy, run_episodes

if TYPE_CHECKING:
    from modpush.evaluation.runner import EvaluationConfig

__all__ = ["run_with_ray"]

_SHARES = 4
"""Parts that an actor's episodes are divided into, so that no actor waits long for the others."""


class _Runner:
    """Runs episodes in an environment of its own, in an actor's process."""

    def __init__(
        self, make_env: Callable[[int], EnvBase], policy: Policy, num_envs: int, seed: int
    ) -> None:
        torch.set_num_threads(1)  # an actor has one CPU
        self._env, self._policy, self._seed = make_env(num_envs), policy, seed

    def run(
        self, episodes: Sequence[tuple[int, Scenario]], options: dict[str, Any]
    ) -> list[Episode]:
        torch.manual_seed(self._seed)
        return list(run_episodes(self._env, self._policy, episodes, **options))


def run_with_ray(
    make_env: Callable[[int], EnvBase],
    policy: Policy,
    episodes: Sequence[tuple[int, Scenario]],
    config: "EvaluationConfig",
    options: dict[str, Any],
) -> Iterator[Episode]:
    """Run episodes in a pool of actors, one for each CPU of the cluster, in any order.

    Args:
        make_env: `number of scenes -> environment`.
        policy: Acts on what the environment emits.
        episodes: Number and start of each.
        config: How episodes are run.
        options: Further arguments of `run_episodes`.

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
        actor = ray.remote(num_cpus=1, max_restarts=RESTARTS, max_task_retries=RESTARTS)(_Runner)
        shared = [ray.put(part) for part in (make_env, policy)]
        count = min(cpus, len(shares))
        actors = [actor.remote(*shared, config.num_envs, config.seed) for _ in range(count)]
        try:
            for done in ActorPool(actors).map_unordered(
                lambda one, share: one.run.remote(share, options), shares
            ):
                yield from done
        finally:
            for one in actors:
                ray.kill(one)
