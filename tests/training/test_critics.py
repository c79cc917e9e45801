"""The critics of a run, read to look at what they expect."""

from pathlib import Path

import pytest
import torch

from modpush._validation import from_plain
from modpush.agents import make_tqc
from modpush.recipes import load_agent
from modpush.training import RunFolder, TrainConfig, load_critics
from modpush.training.run_folder import read_checkpoint
from modpush.viewer import PlayConfig, Session


@pytest.fixture(scope="module")
def env(unbroken):
    env = load_agent(unbroken).make_env(2, seed=0)
    yield env
    env.close()


def test_they_are_those_that_the_loss_trained(unbroken: Path, env) -> None:
    td = load_agent(unbroken).policy(env.reset())
    keys = set(td.keys())
    value = load_critics(unbroken, env)(td)
    assert value.shape == (2,)
    assert set(td.keys()) == keys  # nothing is written
    # TorchRL's own way of calling the copies that a loss holds.
    newest = RunFolder(unbroken).checkpoints.latest()
    assert newest is not None
    state = read_checkpoint(newest)
    loss = make_tqc(from_plain(TrainConfig, state["config"]).tqc, env).loss
    loss.load_state_dict(state["loss"])
    found = []
    for params in loss.qvalue_network_params.unbind(0):
        with params.to_module(loss.qvalue_network), torch.no_grad():
            found.append(loss.qvalue_network(td.copy())["state_action_value"].mean(-1))
    torch.testing.assert_close(value, torch.stack(found).mean(0))


def test_the_page_says_what_they_expect(unbroken: Path) -> None:
    session = Session(PlayConfig(policy=(str(unbroken), "scripted"), scene="free"))
    assert [shown.value for shown in session.snapshots] == [None, None]  # nothing was done yet
    session.tick()
    ours, scripted = session.snapshots
    assert ours.value is not None
    assert scripted.value is None
    session.close()
