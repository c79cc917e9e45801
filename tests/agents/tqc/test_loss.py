"""What TorchRL asks of a loss, and what ours refuses."""

import copy
import pickle
import warnings

import pytest
import torch
from torch import nn
from torchrl.modules import ValueOperator
from torchrl.objectives import HardUpdate, SoftUpdate, TQCLoss as TorchRLTQCLoss

from modpush.agents import TQCLoss
from tests.agents.tqc.tqc_builders import (
    ACT,
    ATOMS,
    OBS,
    make_actor,
    make_batch,
    make_critic,
    make_loss,
)

pytestmark = pytest.mark.filterwarnings("ignore:TQCLoss. these critics cannot be batched")


def total(output):
    return sum(value.sum() for key, value in output.items() if key.startswith("loss_"))


class TwoHeads(nn.Module):
    def __init__(self) -> None:
        super().__init__()
        self.observation = nn.Linear(OBS, ATOMS)
        self.action = nn.Linear(ACT, ATOMS)

    def forward(self, observation, action):
        return self.observation(observation) + self.action(action)


def two_headed_critic():
    return ValueOperator(TwoHeads(), in_keys=["observation", "action"])


def test_each_loss_reaches_only_its_own_parameters():
    for name, prefix in (
        ("loss_actor", "actor_network_params"),
        ("loss_qvalue", "qvalue_network_params"),
        ("loss_alpha", "log_alpha"),
    ):
        loss = make_loss(TQCLoss)
        loss(make_batch(5))[name].backward()
        for key, parameter in loss.named_parameters():
            reached = parameter.grad is not None and bool(parameter.grad.any())
            assert reached == key.startswith(prefix), (name, key)


def test_target_parameters_never_get_gradients():
    loss = make_loss(TQCLoss)
    total(loss(make_batch(5))).backward()
    targets = loss.target_qvalue_network_params
    assert all(t.grad is None and not t.requires_grad for t in targets.values(True, True))


@pytest.mark.parametrize("updater", [SoftUpdate, HardUpdate])
def test_target_updates(updater):
    loss = make_loss(TQCLoss)
    kwargs = {"tau": 0.5} if updater is SoftUpdate else {"value_network_update_interval": 1}
    target_updater = updater(loss, **kwargs)
    source = loss.qvalue_network_params["module", "0", "weight"]
    target = loss.target_qvalue_network_params["module", "0", "weight"]
    torch.testing.assert_close(target, source.data)
    source.data.add_(1.0)
    if updater is HardUpdate:
        target_updater.step()
    target_updater.step()
    expected = source.data - (0.5 if updater is SoftUpdate else 0.0)
    torch.testing.assert_close(target, expected)


def test_one_critic_is_copied_across_the_ensemble():
    loss = TQCLoss(make_actor(), make_critic(), num_qvalue_nets=4)
    assert loss.qvalue_network_params["module", "0", "weight"].shape[0] == 4
    SoftUpdate(loss, tau=0.5)
    loss(make_batch(3))


def test_state_dict_round_trip():
    loss, other = make_loss(TQCLoss, seed=0), make_loss(TQCLoss, seed=5)
    loss(make_batch(3))
    state = loss.state_dict()
    other.load_state_dict(state)
    assert torch.equal(run(loss), run(other))
    theirs = make_loss(TorchRLTQCLoss, seed=6)
    theirs.load_state_dict(state)
    torch.testing.assert_close(run(loss), run(theirs))


def run(loss):
    torch.manual_seed(0)
    return torch.stack([v for k, v in sorted(loss(make_batch(4)).items()) if k != "alpha"])


@pytest.mark.parametrize("critic", [make_critic, two_headed_critic])
def test_deepcopy_and_pickle_are_independent(critic):
    loss = make_loss(TQCLoss, critic=critic)
    before = run(loss)
    copies = [copy.deepcopy(loss), pickle.loads(pickle.dumps(loss))]
    for parameter in loss.parameters():
        parameter.data.mul_(0.5)
    assert not torch.allclose(run(loss), before)
    for twin in copies:
        SoftUpdate(twin, tau=0.5)
        twin.target_qvalue_network_params.data.update_(
            make_loss(TQCLoss, critic=critic).target_qvalue_network_params.data
        )
        torch.testing.assert_close(run(twin), before)


@pytest.mark.parametrize("critic", [make_critic, two_headed_critic])
def test_an_episode_that_is_cut_off_is_bootstrapped_and_one_that_ends_is_not(critic):
    loss, batch = make_loss(TQCLoss, critic=critic), make_batch(5, terminated=False)

    def targets(done, terminated):
        batch["next", "done"], batch["next", "terminated"] = (
            torch.tensor(flags, dtype=torch.bool)[:, None] for flags in (done, terminated)
        )
        torch.manual_seed(0)
        return loss.compute_target(batch)

    going = targets([0, 0, 0, 0, 0], [0, 0, 0, 0, 0])
    assert torch.equal(targets([1, 0, 1, 0, 0], [0, 0, 0, 0, 0]), going)
    ended = targets([1, 0, 1, 0, 0], [1, 0, 0, 0, 0])
    assert torch.equal(ended[1:], going[1:])
    # Nothing comes after the end: every atom of the target is the reward.
    torch.testing.assert_close(ended[0], batch["next", "reward"][0].expand_as(ended[0]))


def test_renamed_and_nested_keys():
    keys = {"action": ("agent", "act"), "reward": ("game", "reward"), "priority": "surprise"}
    keys |= {"terminated": ("game", "over"), "done": ("game", "done")}
    observation, value = ("agent", "obs"), ("agent", "atoms")
    loss = make_loss(
        TQCLoss,
        actor=lambda: make_actor(keys["action"], observation),
        critic=lambda: make_critic(keys["action"], observation, value),
        target_entropy=-2.0,
    )
    loss.set_keys(**keys, state_action_value=value)
    plain = make_batch(5)
    batch = plain.select().set("agent", {"obs": plain["observation"], "act": plain["action"]})
    game = {"reward": plain["next", "reward"], "over": plain["next", "terminated"]}
    batch["next"] = {
        "agent": {"obs": plain["next", "observation"]},
        "game": {**game, "done": game["over"]},
    }
    torch.manual_seed(0)
    renamed = loss(batch)
    torch.manual_seed(0)
    expected = make_loss(TQCLoss, target_entropy=-2.0)
    torch.manual_seed(0)
    expected = expected(plain)
    for key, value in expected.items():
        torch.testing.assert_close(renamed[key], value)
    torch.testing.assert_close(batch["surprise"], plain["td_error"])


def test_critics_that_cannot_be_batched_are_warned_of_once():
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        loss = make_loss(TQCLoss, critic=two_headed_critic)
        loss.set_vmap_randomness("different")
        loss(make_batch(3))
    messages = [str(w.message) for w in caught if "TQCLoss" in str(w.message)]
    assert len(messages) == 1
    assert "(a TwoHeads does not concatenate its inputs)" in messages[0]


@pytest.mark.parametrize(
    "key", ["observation", "action", ("next", "observation"), ("next", "reward")]
)
def test_nan_in_the_batch_is_refused_with_its_key_and_row(key):
    loss, batch = make_loss(TQCLoss), make_batch(5, terminated=False)
    batch[key][3, 0] = float("nan")
    with pytest.raises(ValueError, match=r"NaN or infinite values under .* first at index \[3, 0]"):
        loss(batch)


@pytest.mark.gpu
@pytest.mark.skipif(not torch.cuda.is_available(), reason="no CUDA device")
def test_cuda_equals_cpu():
    results = []
    for device in ("cpu", "cuda"):
        loss = make_loss(TQCLoss).to(device)
        quantiles = loss._atoms(make_batch(6).to(device), loss.qvalue_network_params)
        results.append(quantiles.cpu())
        total(loss(make_batch(6).to(device))).backward()
    torch.testing.assert_close(*results)
