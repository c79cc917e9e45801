"""Our loss against TorchRL's: the same numbers from the same random draws."""

import pytest
import torch
from tensordict.nn import NormalParamExtractor, TensorDictModule
from torch import nn
from torchrl.data import Bounded
from torchrl.modules import ProbabilisticActor, TanhNormal
from torchrl.objectives import TQCLoss as TorchRLTQCLoss

from modpush.agents import TQCLoss, make_actor as make_own_actor, make_critic as make_own_critic
from tests.agents.tqc.tqc_builders import (
    ACT,
    ATOMS,
    CELLS,
    OBS,
    make_actor,
    make_batch,
    make_critic,
    make_loss,
)

pytestmark = pytest.mark.filterwarnings("ignore:TQCLoss. these critics cannot be batched")

TOLERANCE = {torch.float32: 1e-6, torch.float64: 1e-10}
# Most numbers are equal to the bit; of a few the last of eight bits is rounded the other way.
BFLOAT16_TOLERANCE = 2e-2


def assert_same(ours, theirs, relative: float) -> None:
    """Equal up to `relative` times the largest value of the tensor."""
    scale = theirs.abs().max().item()
    assert (ours - theirs).abs().max().item() <= relative * max(scale, 1e-12)


def assert_same_as_torchrl(
    batch, *, dtype=torch.float32, mutate=None, autocast=False, **kwargs
) -> None:
    """Same losses, priorities and gradients of both classes on one batch."""
    results = []
    for cls in (TQCLoss, TorchRLTQCLoss):
        loss = make_loss(cls, dtype=dtype, **kwargs)
        if mutate is not None:
            mutate(loss)
        mine = batch.clone()
        with torch.autocast("cpu", dtype=torch.bfloat16, enabled=autocast):
            torch.manual_seed(7)
            targets = loss.compute_target(mine)
            torch.manual_seed(8)
            output = loss(mine)
        total = sum(value.sum() for key, value in output.items() if key.startswith("loss_"))
        total.backward()
        gradients = {name: p.grad for name, p in loss.named_parameters() if p.requires_grad}
        results.append((targets, output, mine["td_error"], gradients))
    (targets, output, error, gradients), (targets_, output_, error_, gradients_) = results
    relative = BFLOAT16_TOLERANCE if autocast else TOLERANCE[dtype]
    assert_same(targets, targets_, relative)
    assert_same(error, error_, relative)
    assert set(output.keys()) == set(output_.keys())
    for key, value in output_.items():
        assert (output[key].shape, output[key].dtype) == (value.shape, value.dtype)
        assert_same(output[key], value, relative)
    assert gradients.keys() == gradients_.keys()
    for name, gradient in gradients_.items():
        assert (gradients[name] is None) == (gradient is None), name
        if gradient is not None:
            assert_same(gradients[name], gradient, relative)


def layer_norm_critic():
    return make_critic(
        norm_class=nn.LayerNorm, norm_kwargs=[{"normalized_shape": width} for width in CELLS]
    )


def gelu_critic():
    return make_critic(activation_class=nn.GELU)


def biasless_critic():
    return make_critic(layer_kwargs={"bias": False})


def linear_critic():
    return make_critic(num_cells=[])


def our_critic():
    return make_own_critic(OBS, ACT, ATOMS, CELLS)


def our_layer_norm_critic():
    return make_own_critic(OBS, ACT, ATOMS, CELLS, layer_norm=True)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize(
    "critic",
    [
        make_critic,
        layer_norm_critic,
        gelu_critic,
        biasless_critic,
        linear_critic,
        our_critic,
        our_layer_norm_critic,
    ],
)
def test_every_kind_of_critic(critic, dtype):
    assert_same_as_torchrl(make_batch(9, dtype=dtype), critic=critic, dtype=dtype)


def our_actor():
    return make_own_actor(OBS, Bounded(-1, 1, (ACT,)), CELLS)


@pytest.mark.parametrize("size", [9, 96])
@pytest.mark.parametrize("actor", [make_actor, our_actor])
@pytest.mark.parametrize(
    "critic", [make_critic, layer_norm_critic, gelu_critic, biasless_critic, our_critic]
)
def test_under_autocast(critic, actor, size):
    assert_same_as_torchrl(make_batch(size), critic=critic, actor=actor, autocast=True)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize(
    "options",
    [
        {"low": -2, "high": 3.0},
        {"low": torch.tensor([-1.0, 0.0]), "high": torch.tensor([1.0, 4.0])},
        {"low": -0.5},
        {"tanh_loc": True},
        {"safe_tanh": False, "high": 2.0},
    ],
    ids=str,
)
def test_every_kind_of_bounded_actor(options, dtype):
    assert_same_as_torchrl(
        make_batch(9, dtype=dtype), actor=lambda: make_actor(**options), dtype=dtype
    )


@pytest.mark.parametrize("reduction", ["none", "mean", "sum"])
@pytest.mark.parametrize("weighted", [False, True])
def test_every_reduction_with_and_without_priority_weights(reduction, weighted):
    batch = make_batch(9)
    if weighted:
        batch["priority_weight"] = torch.rand(9)
    assert_same_as_torchrl(batch, reduction=reduction)


@pytest.mark.parametrize("num_critics", [1, 2, 5])
@pytest.mark.parametrize("dropped", [0, 1, 6])
def test_every_ensemble_and_truncation(num_critics, dropped):
    assert_same_as_torchrl(
        make_batch(5),
        num_critics=num_critics,
        top_quantiles_to_drop_per_net=dropped,
    )


@pytest.mark.parametrize(
    "options",
    [
        {"delay_qvalue": False},
        {"fixed_alpha": True},
        {"min_alpha": 0.5, "max_alpha": 0.9},
        {"target_entropy": -0.3},
        {"deactivate_vmap": True},
        {"separate_losses": True},
        {"gamma": 0.0},
    ],
)
def test_every_option(options):
    assert_same_as_torchrl(make_batch(6), **options)


def test_batches_of_several_dimensions():
    assert_same_as_torchrl(make_batch(3, 4))


def test_nan_after_terminal_states():
    batch = make_batch(12)
    terminal = batch["next", "terminated"].squeeze(-1)
    assert terminal.any()
    assert not terminal.all()
    batch["next", "observation"][terminal] = float("nan")
    assert_same_as_torchrl(batch, skip_done_states=True)


def test_all_states_terminal():
    batch = make_batch(4)
    batch["next", "terminated"].fill_(True)
    batch["next", "observation"].fill_(float("nan"))
    assert_same_as_torchrl(batch, skip_done_states=True)


def test_n_step_targets():
    batch = make_batch(8)
    batch["steps_to_next_obs"] = torch.randint(1, 4, (8, 1))
    assert_same_as_torchrl(batch)


def test_large_errors_on_both_sides_of_the_huber_threshold():
    batch = make_batch(16)
    batch["next", "reward"] *= 100
    assert_same_as_torchrl(batch)


def one_activation_for_all_layers():
    activation = nn.Tanh()
    return make_critic(activation_class=lambda **_: activation)


def one_layer_twice():
    critic = make_critic(num_cells=[12, 12, 12])
    critic.module[4] = critic.module[2]
    return critic


@pytest.mark.parametrize("critic", [one_activation_for_all_layers, one_layer_twice])
def test_critics_in_which_one_module_stands_twice(critic):
    assert_same_as_torchrl(make_batch(6), critic=critic)


class Gaussian(nn.Module):
    """A network whose arguments and methods have names of their own."""

    def __init__(self) -> None:
        super().__init__()
        self.trunk = nn.Sequential(nn.Linear(OBS, 2 * ACT), NormalParamExtractor())

    def forward(self, scaled=None, observation=None):
        return self.trunk(observation if scaled is None else -scaled)

    def act(self, observation, factor=2.0):
        loc, scale = self.trunk(observation)
        return factor * loc, scale


@pytest.mark.parametrize(
    "options",
    [
        {"in_keys": {"observation": "observation"}},
        {"in_keys": {"observation": "scaled"}, "out_to_in_map": False},
        {"method": "act"},
        {"method": "act", "method_kwargs": {"factor": 3.0}},
    ],
    ids=str,
)
def test_actors_whose_network_is_called_in_another_way(options):
    def actor():
        options_ = {"in_keys": ["observation"], "out_keys": ["loc", "scale"], **options}
        return ProbabilisticActor(
            TensorDictModule(Gaussian(), **options_),
            in_keys=["loc", "scale"],
            spec=Bounded(-1, 1, (ACT,)),
            distribution_class=TanhNormal,
        )

    assert_same_as_torchrl(make_batch(6), actor=actor)


def test_a_whole_training_run_stays_together():
    """Twenty Adam steps of both losses end at the same parameters."""
    from torchrl.objectives import SoftUpdate

    ends = []
    for cls in (TQCLoss, TorchRLTQCLoss):
        loss = make_loss(cls, dtype=torch.float64)
        updater = SoftUpdate(loss, tau=0.05)
        optimizer = torch.optim.Adam([p for p in loss.parameters() if p.requires_grad], lr=1e-3)
        torch.manual_seed(3)
        for step in range(20):
            output = loss(make_batch(8, seed=step, dtype=torch.float64))
            sum(v for k, v in output.items() if k.startswith("loss_")).backward()
            optimizer.step()
            optimizer.zero_grad()
            updater.step()
        ends.append(loss.state_dict())
    for name, value in ends[1].items():
        if torch.is_tensor(value) and value.is_floating_point():
            torch.testing.assert_close(ends[0][name], value, rtol=1e-8, atol=1e-10)
