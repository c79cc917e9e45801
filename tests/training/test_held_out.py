"""Which of a run's policies is kept as the best."""

import math
from dataclasses import replace

import pandas as pd
import pytest
import torch

from modpush.recipes import load_agent, make_push_env
from modpush.training import Trainer
from modpush.training.held_out import HeldOutEpisodes, held_out_scenarios, held_out_score
from tests.training.conftest import SMOKE

EARLY = {"success": 1.0, "spl": 0.901, "contact_rate": 0.960, "collision_rate": 0.024}
LATE = {"success": 119 / 120, "spl": 0.910, "contact_rate": 0.985, "collision_rate": 0.008}


def test_an_episode_more_does_not_outweigh_contact_and_collisions():
    assert held_out_score(LATE) > held_out_score(EARLY)
    assert held_out_score(EARLY | {"success": 0.9}) < held_out_score(EARLY)
    assert held_out_score({"success": 1, "spl": 1, "contact_rate": 1, "collision_rate": 0}) == 3
    assert held_out_score({"success": 0, "spl": 0, "contact_rate": 0, "collision_rate": 1}) == -1


def test_halves_have_the_rows_of_the_whole_and_draw_nothing(tmp_path):
    """Another batch, other scenes beside each episode, and an environment that has run before."""
    config = replace(SMOKE, evaluation_episodes=7)
    trainer = Trainer(replace(SMOKE, total_steps=96), tmp_path / "run")
    actor = trainer.learner.averaged_actor

    def make_env(*args, **kwargs):
        torch.rand(3)  # as an autoencoder draws its first weights, which are then loaded
        return make_push_env(*args, **kwargs)

    episodes = HeldOutEpisodes(config, {}, make_env)
    state = torch.get_rng_state()
    whole = episodes.run(actor)
    halves = [*episodes.run(actor, range(3)), *episodes.run(actor, range(3, 7))]
    assert torch.equal(torch.get_rng_state(), state)
    episodes.close()
    trainer.close()
    assert [row["episode"] for row in whole] == list(range(7))
    assert len({row["path_length"] for row in whole}) == 7
    pd.testing.assert_frame_equal(pd.DataFrame(whole), pd.DataFrame(halves), check_exact=True)


def held_out_rows(trainer, evaluation):
    """A row for each held-out episode with these means."""
    count = trainer.config.evaluation_episodes
    rows = pd.DataFrame({name: [value] * count for name, value in evaluation.items()})
    return rows.assign(collision_rate_object=0.0, steps=30, out_of_bounds=False, scene="free")


def test_the_best_agent_is_the_one_with_the_highest_score(tmp_path, monkeypatch):
    """Real weights and files; the evaluations are given, in the order early, late, early."""
    trainer = Trainer(replace(SMOKE, checkpoint_every=48, evaluate_every=48), tmp_path / "run")
    assert trainer.best_evaluation() == {}
    given = [EARLY, LATE, EARLY]
    weights = []

    def evaluation(method, *_args):
        weights.append(
            {k: v.clone() for k, v in trainer.learner.averaged_actor.state_dict().items()}
        )
        return held_out_rows(trainer, given[len(weights) - 1]).to_dict("list")

    monkeypatch.setattr(trainer.worker, "call", evaluation)
    for _ in given:
        trainer._evaluate()
        with torch.no_grad():
            for parameter in trainer.learner.averaged_actor.parameters():
                parameter.add_(0.01)
    trainer.close()

    assert trainer.best_evaluation()["spl"] == pytest.approx(LATE["spl"])
    best = load_agent(tmp_path / "run" / "best_agent.safetensors").actor.state_dict()
    last = load_agent(tmp_path / "run" / "last_agent.safetensors").actor.state_dict()
    for name, value in best.items():
        assert torch.equal(value, weights[1][name]), name
    assert any(not torch.equal(last[name], best[name]) for name in best)


def test_held_out_episodes_are_as_hard_and_as_far_as_the_environments():
    env = SMOKE.env.with_fields(difficulty=(0.4, 0.5), distance=(0.55, 0.6))
    drawn = held_out_scenarios(replace(SMOKE, env=env, evaluation_episodes=6))
    assert all(0.4 <= scenario.difficulty <= 0.5 for scenario in drawn)
    away = [math.dist(s.object_pose[:2], s.goal_position) for s in drawn]
    assert all(0.55 <= distance <= 0.6 for distance in away)
