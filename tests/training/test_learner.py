"""When the learner makes its updates, and what it tells the sampler, without a simulator."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torchrl.data import Bounded, Composite, Unbounded

from modpush.training.learner import Learner, zero_input_weights
from modpush.training.scene_worker import Rollout, WorkerSpecs
from tests.training.conftest import SMOKE

SCENES = SMOKE.env.num_envs  # 2


def make_learner(folder: Path, **changes: Any) -> Learner:
    specs = WorkerSpecs(
        observation=Composite(observation=Unbounded((4,))),
        action=Bounded(-1, 1, (3,)),
        columns={},
        fingerprint={},
    )
    return Learner(replace(SMOKE, **changes), specs, {}, folder)


def rollout(number: int, steps: int = 4, **about: Any) -> Rollout:
    """What two scenes did in some steps; all observations tell the rollout's number."""
    count = SCENES * steps
    rng = np.random.default_rng(number)
    observation = rng.normal(size=(count, 4)).astype(np.float32)
    observation[:, 0] = number
    after = rng.normal(size=(count, 4)).astype(np.float32)
    flags = np.zeros((count, 1), dtype=bool)
    return Rollout(
        transitions={
            "observation": observation,
            "action": np.zeros((count, 3), dtype=np.float32),
            ("next", "observation"): after,
            ("next", "reward"): np.ones((count, 1), dtype=np.float32),
            ("next", "done"): flags,
            ("next", "terminated"): flags,
        },
        last_observation=after[-SCENES:],
        episodes=[],
        level=0,
        success_by_family={},
        **about,
    )


def test_updates_are_paced_from_the_step_on_at_which_learning_starts(tmp_path: Path) -> None:
    tqc = replace(SMOKE.tqc, learning_starts=70, updates_per_step=0.1875)
    learner, made = make_learner(tmp_path, tqc=tqc), []
    for number in range(12):
        before = number * 8
        assert learner.store(rollout(number)) == 8
        learner.learn(before, before + 8)
        made.append(learner.updates)
    # Rollouts of 8 steps: learning starts within the ninth. (72 - 70) * 0.1875 = 0.375, then 1.875,
    # 3.375 and 4.875; what is less than an update waits for the next rollout.
    assert made == [0] * 9 + [1, 3, 4]


def test_the_present_states_are_those_of_all_scenes_of_all_collectors(tmp_path: Path) -> None:
    learner = make_learner(tmp_path)
    first, second, third = rollout(1), rollout(2, source=1), rollout(3)
    for each in (first, second, third):
        learner.store(each)
    expected = np.concatenate([third.last_observation, second.last_observation])
    assert torch.equal(learner.buffer.sampler._queries(None), torch.from_numpy(expected))


def test_columns_without_effect_are_so_in_actor_critics_and_targets(tmp_path: Path) -> None:
    loss = make_learner(tmp_path).agent.loss
    zero_input_weights(loss, slice(1, 3))
    names = ("actor_network_params", "qvalue_network_params", "target_qvalue_network_params")
    for name in names:
        networks = dict(loss.named_children())[name]
        first = next(value for value in networks.values(True, True) if value.ndim > 1)
        used = first.abs().flatten(0, -2).sum(0) > 0
        critics = name != "actor_network_params"
        # Observation and, of critics, action.
        assert used.tolist() == [True, False, False, True, *[True] * 3 * critics], name
