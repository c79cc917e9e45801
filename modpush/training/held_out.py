"""The episodes that a run is evaluated on while it trains, and how its policies are compared there."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from modpush._arguments import checked_arguments
from modpush.envs.scenes.sampling import sample_scenario
from modpush.envs.scenes.scenario import Scenario, ScenarioConfig
from modpush.training.config import TrainConfig

__all__ = ["held_out_scenarios", "held_out_score"]

_HELD_OUT_SEED = 20_221_023  # no training run and no evaluation set draws with it


@checked_arguments
def held_out_scenarios(
    config: TrainConfig, *, scene: Any = None, pushed_object: Any = None
) -> list[Scenario]:
    """Episodes to evaluate on during training: never trained on, and the same in every run.

    Difficulty and distance are those of the environment's config, whatever the curriculum draws.

    Args:
        config: The run's configuration.
        scene: Scene families given as objects, instead of those that the config names.
        pushed_object: Objects given as such, instead of those that the config names.
    """
    families = config.curriculum.phases[-1].scenes or scene or config.env.scene
    families = [families] if isinstance(families, str) or callable(families) else list(families)
    base = ScenarioConfig(
        pushed_object=config.env.pushed_object if pushed_object is None else pushed_object,
        difficulty=config.env.difficulty,
        distance=config.env.distance,
        path_inflation=config.env.path_inflation,
    )
    return [
        sample_scenario(
            np.random.default_rng([_HELD_OUT_SEED, n]),
            replace(base, scene=families[n % len(families)]),
            tool=config.env.tool,
        )
        for n in range(config.evaluation_episodes)
    ]


def held_out_score(evaluation: Mapping[str, float]) -> float:
    """What a run's policies are compared by: the four figures of the paper's tables, weighted alike.

    Success alone hardly tells late policies apart: those of the preset `cpu` solve 118 to 120 of its 120
    episodes, while contact, collisions and SPL still improve.

    Args:
        evaluation: Means over the held-out episodes, a row of `evaluations.csv`.

    Returns:
        Success rate plus SPL plus contact rate less collision rate, from -1 to 3.
    """
    kept = evaluation["success"] + evaluation["spl"] + evaluation["contact_rate"]
    return float(kept - evaluation["collision_rate"])
