"""Who acts before the first update, and the averaged actor."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from modpush.training import TRAIN_PRESETS, TrainConfig, Trainer
from modpush.training.learner import weights_of
from modpush.training.scene_worker import SceneWorker

SMOKE = TRAIN_PRESETS["smoke"]


def worker_of(config: TrainConfig) -> SceneWorker:
    worker = SceneWorker(config)
    worker.restart(3)
    return worker


@pytest.mark.parametrize("precision", ["float32", "bfloat16"])
def test_scenes_act_in_the_precision_of_the_updates(precision: str) -> None:
    worker = worker_of(replace(SMOKE, tqc=replace(SMOKE.tqc, precision=precision)))
    seen, actions = [], []
    for layer in worker.actor.modules():
        if isinstance(layer, torch.nn.Linear):
            layer.register_forward_hook(lambda _, __, output: seen.append(output.dtype))
    worker.actor.register_forward_hook(lambda _, __, output: actions.append(output["action"].dtype))
    worker.collect(2, weights_of(worker.actor))
    worker.close()
    assert {*seen} == {getattr(torch, precision)}
    assert {*actions} == {torch.float32}


def test_a_collector_elsewhere_acts_in_a_precision_that_its_processor_has(monkeypatch) -> None:
    tqc = replace(SMOKE.tqc, precision="bfloat16")
    found = {}
    for capability in ("avx512_bf16", "avx2"):
        monkeypatch.setattr(torch.cpu, "get_capabilities", lambda c=capability: {c: True})
        worker = SceneWorker(replace(SMOKE, tqc=tqc, collector="ray", async_collection=True))
        found[capability] = worker._precision
        worker.close()
    assert found == {"avx512_bf16": "bfloat16", "avx2": "float32"}


@pytest.mark.parametrize("frames", [("path", None), ("object", "base"), ("object", None)])
def test_the_scripted_pusher_solves_episodes_in_the_agents_own_frame(frames) -> None:
    frame, action_frame = frames
    env = SMOKE.env.with_fields(
        num_envs=6, frame=frame, action_frame=action_frame, max_episode_steps=100
    )
    config = replace(SMOKE, env=env, tqc=replace(SMOKE.tqc, learning_starts=600), greedy_envs=1)
    worker = worker_of(config)
    rollout = worker.collect(100, None)
    worker.close()
    assert np.abs(rollout.transitions["action"]).max() <= 1.0
    episodes = rollout.episodes
    # Six scenes of free space for 100 steps, 0.2 to 0.6 m each: some 40 steps an episode.
    assert len(episodes) >= 8
    assert np.mean([episode["success"] for episode in episodes]) >= 0.9
    assert not any(episode["greedy"] for episode in episodes)
    assert rollout.level == 0
    assert not rollout.success_by_family, "episodes of the warm-up must not count"


def test_a_run_from_trained_weights_has_no_first_actions_of_another() -> None:
    worker = SceneWorker(replace(SMOKE, init_from="small_cube"))
    worker.close()
    assert worker.curriculum.warm_up == 0


def test_the_evaluated_actor_is_the_moving_average_of_all_updates(tmp_path) -> None:
    trainer = Trainer(replace(SMOKE, actor_average=0.5), tmp_path / "run")
    learner = trainer.learner
    assert learner.averaged_actor is learner.agent.actor, "there is nothing to average yet"
    seen: list[dict[str, np.ndarray]] = []
    update = learner.agent.update

    def noted(batch):
        result = update(batch)
        seen.append(weights_of(learner.agent.actor))
        return result

    object.__setattr__(learner.agent, "update", noted)
    trainer.run()
    assert len(seen) == learner.updates >= 10
    expected = seen[0]
    for weights in seen[1:]:
        expected = {name: 0.5 * expected[name] + 0.5 * weights[name] for name in expected}
    found = weights_of(learner.averaged_actor)
    assert found.keys() == expected.keys()
    for name in found:
        np.testing.assert_allclose(found[name], expected[name], rtol=1e-5, atol=1e-7)
    assert any(not np.allclose(found[name], seen[-1][name], atol=1e-6) for name in found)
