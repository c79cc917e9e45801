"""The episodes that a run is evaluated on while it trains, and how its policies are compared there."""

from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from dataclasses import replace
from multiprocessing.sharedctypes import RawValue
from typing import Any

import numpy as np
import torch
from torchrl.envs import EnvBase

from modpush._validation import checked_arguments
from modpush.envs.scenes.sampling import sample_scenario
from modpush.envs.scenes.scenario import Scenario
from modpush.evaluation.episodes import Policy, run_episodes
from modpush.recipes.make_env import env_parts
from modpush.training.config import TrainConfig

_HELD_OUT_SEED = 20_221_023  # no training run and no evaluation set draws with it
_ENVS = 8


@checked_arguments
def held_out_scenarios(
    config: TrainConfig, *, scene: Any = None, pushed_object: Any = None
) -> list[Scenario]:
    """Episodes to evaluate on during training: never trained on, and the same in every run.

    Difficulty and distance are those of the environment's config, whatever the curriculum draws; mass,
    friction and centre of mass are the nominal ones also where training draws them.

    Args:
        config: The run's configuration.
        scene: Scene families given as objects, instead of those that the config names.
        pushed_object: Objects given as such, instead of those that the config names.
    """
    base = replace(config.env.filled_scenario(), randomize_dynamics=False)
    if pushed_object is not None:
        base = replace(base, pushed_object=pushed_object)
    last = config.curriculum.phases[-1].scenes or scene
    families = replace(base, scene=last).scene if last else base.scene
    return [
        sample_scenario(
            np.random.default_rng([_HELD_OUT_SEED, n]),
            replace(base, scene=families[n % len(families)]),
            tool=config.env.simulation.tool,
            robot=config.env.simulation.robot,
            goal=config.env.simulation.goal,
        )
        for n in range(config.evaluation_episodes)
    ]


class EvaluationProgress:
    """Progress of held-out episodes, and a request to stop, shared with a process that is started.

    `other` is the progress of the episodes of another process, which are to stop together with these.
    """

    def __init__(self, other: "EvaluationProgress | None" = None) -> None:
        self.stop: Any = RawValue("b", 0) if other is None else other.stop
        """Its `value` is not 0 if episodes are to stop where they are."""
        self.ended: Any = RawValue("l", 0)
        """Its `value` is the number of episodes that have ended in the present call."""
        self.on_episode: Callable[[], Any] = _nothing
        """Called in the process of the episodes when one has ended."""


def _nothing() -> None: ...


class _StoppedError(Exception):
    """Episodes were to stop where they are."""


class HeldOutEpisodes:
    """Runs held-out episodes in an environment of its own, which the first call makes.

    `progress` is kept up to date, and may stop the episodes.
    """

    def __init__(
        self,
        config: TrainConfig,
        parts: Mapping[str, Any],
        make_env: Callable[..., EnvBase],
        progress: EvaluationProgress | None = None,
    ) -> None:
        self._progress = progress or EvaluationProgress()
        self._config, self._make_env, self._parts = config, make_env, env_parts(config.env, parts)
        self._env: EnvBase | None = None
        self._scenarios = held_out_scenarios(
            config,
            scene=self._parts.get("scene"),
            pushed_object=self._parts.get("pushed_object"),
        )

    def run(self, policy: Policy, numbers: Iterable[int] | None = None) -> list[dict[str, Any]]:
        """Run episodes greedily, all or those of some numbers; a row of metrics for each, by number.

        Where they were stopped there are rows of those that had ended. Torch's random state stays what
        it was.
        """
        self._progress.ended.value = 0
        chosen = range(len(self._scenarios)) if numbers is None else numbers
        with torch.random.fork_rng(devices=[]):
            if self._env is None:
                few = min(self._config.env.num_envs, _ENVS)  # each takes memory
                env_config = replace(self._config.env, recovery=False, num_envs=few)
                self._env = self._make_env(env_config, **self._parts)
            episodes = run_episodes(
                self._env,
                policy,
                ((number, self._scenarios[number]) for number in chosen),
                inflation=self._config.env.path_inflation,
                on_step=self._check_stop,
            )
            rows = []
            with suppress(_StoppedError):
                for e in episodes:
                    row = {"episode": e.number, "scene": e.scenario.scene, **e.metrics.to_dict()}
                    rows.append(row)
                    self._progress.ended.value += 1
                    self._progress.on_episode()
        return sorted(rows, key=lambda row: row["episode"])

    def _check_stop(self, *_: int) -> None:
        if self._progress.stop.value:
            raise _StoppedError

    def close(self) -> None:
        """Free the simulator."""
        if self._env is not None and not self._env.is_closed:
            self._env.close()


def held_out_score(evaluation: Mapping[str, float]) -> float:
    """Score of a policy, -1 to 3: success rate plus SPL plus contact rate less collision rate.

    Success alone hardly tells late policies apart: those of the preset `cpu` solve 118 to 120 of its 120
    episodes, while contact, collisions and SPL still improve.
    """
    kept = evaluation["success"] + evaluation["spl"] + evaluation["contact_rate"]
    return float(kept - evaluation["collision_rate"])
