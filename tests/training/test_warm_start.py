"""Runs that begin with trained weights, and runs that resume without their replay buffer."""

from dataclasses import replace

import pandas as pd
import pytest
import torch
from torchrl.data import Bounded, Composite, Unbounded

from modpush import load_agent
from modpush.agents import TQCConfig, make_tqc_from_specs
from modpush.training import Trainer
from modpush.training.run_folder import RunFolder
from modpush.training.warm_start import _copy_to_targets
from tests.training.conftest import SMOKE


def begin(folder, **changes):
    """A trainer that has learned nothing yet, closed again."""
    trainer = Trainer(replace(SMOKE, **{"seed": 5, **changes}), folder)
    trainer.close()
    return trainer.learner.agent


def assert_equal(one, other):
    assert one.keys() == other.keys()
    for name, value in one.items():
        if isinstance(value, torch.Tensor):
            assert torch.equal(value, other[name]), name


def test_an_agents_file_gives_the_actors_weights(unbroken, tmp_path):
    file = unbroken / "last_agent.safetensors"
    agent = begin(tmp_path / "run", init_from=str(file))
    assert_equal(load_agent(file).actor.state_dict(), agent.actor.state_dict())
    fresh = begin(tmp_path / "fresh").loss.state_dict()
    loss = agent.loss.state_dict()
    assert all(torch.equal(loss[name], fresh[name]) for name in loss if "qvalue" in name)
    assert not all(torch.equal(loss[name], fresh[name]) for name in loss if "actor" in name)


def test_a_run_gives_critics_targets_and_temperature_too(unbroken, tmp_path):
    state = RunFolder(unbroken).checkpoints.load()["loss"]
    assert_equal(state, begin(tmp_path / "run", init_from=str(unbroken)).loss.state_dict())
    newest = RunFolder(unbroken).checkpoints.latest()
    assert_equal(state, begin(tmp_path / "run2", init_from=str(newest)).loss.state_dict())


def test_it_acts_with_these_weights_from_the_first_step(unbroken, tmp_path):
    Trainer(replace(SMOKE, init_from=str(unbroken), total_steps=64), tmp_path / "run").run()
    # The run's log has a row each 48 steps, and its scenes act at random for 64.
    assert "greedy/success" in pd.read_csv(tmp_path / "run" / "log.csv")
    first = Trainer(replace(SMOKE, init_from=str(unbroken)), tmp_path / "other")
    first._first_rollout()
    rollout = first.worker.result()
    first.close()
    assert rollout.transitions["action"].shape == (16, 3)
    again = Trainer(replace(SMOKE, init_from=str(unbroken)), tmp_path / "again")
    again.learner.agent.actor.module[0].module[0][0].weight.data.add_(1.0)
    again._first_rollout()
    other = again.worker.result()
    again.close()
    assert not (rollout.transitions["action"] == other.transitions["action"]).all()


def test_entries_that_the_weights_do_not_know_begin_with_zero_weights(unbroken, tmp_path):
    before = begin(tmp_path / "before", init_from=str(unbroken))
    env = replace(SMOKE.env, add=("history", "goal"))
    for source in (unbroken, unbroken / "last_agent.safetensors"):
        wide = begin(tmp_path / f"wide_{source.name}", init_from=str(source), env=env)
        old, new = (
            before.actor.module[0].module[0][0].weight,
            wide.actor.module[0].module[0][0].weight,
        )
        assert new.shape[-1] == old.shape[-1] + 80 + 2
        assert not new[:, old.shape[-1] :].any()
        if source == unbroken:
            assert torch.equal(new[:, : old.shape[-1]], old)
    run = begin(tmp_path / "run", init_from=str(unbroken), env=env).loss
    old, new = (
        next(v for v in loss.target_qvalue_network_params.values(True, True) if v.ndim == 3)
        for loss in (before.loss, run)
    )
    width = old.shape[-1] - 3
    assert torch.equal(new[..., :width], old[..., :width])
    assert torch.equal(new[..., -3:], old[..., -3:])  # the action
    assert not new[..., width:-3].any()


def test_the_target_of_a_trained_actor_begins_as_the_actor():
    config, observed = TQCConfig(hidden_sizes=(8,), loss="td3"), Composite(observation=Unbounded(3))
    loss = make_tqc_from_specs(config, observed, Bounded(-1, 1, (2,))).loss
    actor, target = loss.actor_network_params, loss.target_actor_network_params
    critics = loss.target_qvalue_network_params.clone()
    for value in actor.values(True, True):
        value.data.fill_(0.25)
    _copy_to_targets(loss)
    assert all((value == 0.25).all() for value in target.values(True, True))
    assert (loss.target_qvalue_network_params == critics).all()


def test_what_cannot_be_taken_over_is_refused_before_any_work(unbroken, tmp_path):
    def refused(message, **changes):
        with pytest.raises(ValueError, match=message):
            begin(tmp_path / "run", **{"init_from": str(unbroken), **changes})

    refused(
        "expected a run's folder, a checkpoint, .*any_object, paper, pose, small_cube",
        init_from="nobody",
    )
    refused("must be a run with a checkpoint", init_from=str(tmp_path))
    refused("another architecture", tqc=replace(SMOKE.tqc, hidden_sizes=(8,)))
    refused("trained in another environment.*edges", env=replace(SMOKE.env, leave_out=("edges",)))
    fragment = SMOKE.env.with_fields(pushed_object="fragment")
    refused("looking the same at 4 yaw angles.*set env.symmetry to 4", env=fragment)
    begin(tmp_path / "run", init_from=str(unbroken), env=replace(fragment, symmetry=4))


def test_a_run_without_its_buffer_fills_one_before_it_learns_on(unbroken, tmp_path):
    config = replace(SMOKE, save_buffer=False)
    Trainer(replace(config, total_steps=96), tmp_path / "run").run()
    sizes = [path.stat().st_size for path in (tmp_path / "run" / "checkpoints").iterdir()]
    whole = [path.stat().st_size for path in (unbroken / "checkpoints").iterdir()]
    assert max(sizes) < min(whole)

    resumed = Trainer(config, tmp_path / "run", resume=True)
    before = resumed.learner.updates
    assert (resumed.steps, len(resumed.learner.buffer)) == (96, 0)
    state = resumed.learner.agent.optimizer.state_dict()["state"]
    assert state[0]["step"] == before > 0
    resumed.run()
    # 64 steps of filling, then the updates that are due for the other 32.
    due = (192 - 96 - SMOKE.tqc.learning_starts) * SMOKE.tqc.updates_per_step
    assert before + int(due) <= resumed.learner.updates <= before + int(due) + 1
    assert len(resumed.learner.buffer) == 96
    table = pd.read_csv(tmp_path / "run" / "evaluations.csv")
    assert table["step"].tolist() == [96, 192]


def test_the_target_of_a_trained_encoder_begins_as_the_encoder(tmp_path):
    changes = {
        "env": replace(SMOKE.env, encoder="end_to_end", window_size=32),
        "tqc": replace(SMOKE.tqc, encoder="tests.own_parts:SmallConv"),
    }
    trainer = Trainer(replace(SMOKE, total_steps=64, **changes), tmp_path / "run")
    trainer.run()
    file = tmp_path / "run" / "last_agent.safetensors"
    loss = begin(tmp_path / "second", init_from=str(file), seed=9, **changes).loss
    state = loss.state_dict()
    names = [name for name in state if name.startswith("encoder_params.")]
    assert names
    for name in names:
        assert torch.equal(state[name], state[f"target_{name}"]), name
