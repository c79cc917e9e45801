"""The fused stack of layers against torch's own, with either library's products."""

import importlib
import itertools

import pytest
import torch
from torch import Tensor, nn
from torchrl.modules import MLP

from modpush.agents.tqc.relu_mlp import ReluMLP, relu_mlp
from tests.agents.tqc.test_loss_parity import assert_same_as_torchrl, relu_mlp_critic
from tests.agents.tqc.tqc_builders import make_batch

module = importlib.import_module("modpush.agents.tqc.relu_mlp")
SIZES = (7, 40, 96, 5)


@pytest.fixture(params=[True, False], ids=["onednn", "torch"], autouse=True)
def library(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> bool:
    monkeypatch.setattr(module, "_onednn_is_faster", lambda: request.param)
    return request.param


def networks(count: int) -> list[nn.Sequential]:
    torch.manual_seed(0)
    first, second, third = itertools.pairwise(SIZES)
    return [
        nn.Sequential(
            *(nn.Linear(*first), nn.ReLU(), nn.Linear(*second), nn.ReLU(), nn.Linear(*third))
        )
        for _ in range(count)
    ]


def stacked(nets: list[nn.Sequential]) -> tuple[list[Tensor], list[Tensor]]:
    layers = range(0, len(nets[0]), 2)
    weights = [torch.stack([net[i].weight.detach() for net in nets]) for i in layers]
    biases = [torch.stack([net[i].bias.detach() for net in nets]) for i in layers]
    return [w.requires_grad_() for w in weights], [b.requires_grad_() for b in biases]


@pytest.mark.parametrize("rows", [1, 63, 64, 300])
@pytest.mark.parametrize("count", [1, 3])
def test_outputs_and_all_gradients_are_those_of_the_layers(rows, count):
    nets = networks(count)
    weights, biases = stacked(nets)
    state = torch.randn(rows, 4, requires_grad=True)
    action = torch.randn(rows, 3, requires_grad=True)
    seed = torch.randn(count, rows, SIZES[-1])

    expected = torch.stack([net(torch.cat([state, action], -1)) for net in nets])
    parameters = [p for net in nets for p in net.parameters()]
    *of_parameters, of_state, of_action = torch.autograd.grad(
        expected, [*parameters, state, action], seed
    )
    per_layer = zip(*[iter(of_parameters)] * (len(of_parameters) // count), strict=True)
    of_layers = [torch.stack(gradients) for gradients in zip(*per_layer, strict=True)]

    output = relu_mlp([state, action], weights, biases)
    close = {"rtol": 1e-4, "atol": 1e-5 * rows**0.5}
    torch.testing.assert_close(output, expected, **close)
    with torch.no_grad():
        torch.testing.assert_close(relu_mlp([state, action], weights, biases), output.detach())
    mine = torch.autograd.grad(output, [*weights, *biases, state, action], seed)
    for gradient, reference in zip(
        mine, [*of_layers[::2], *of_layers[1::2], of_state, of_action], strict=True
    ):
        torch.testing.assert_close(gradient, reference, **close)


@pytest.mark.parametrize("rows", [5, 80])
def test_a_gradient_penalty_has_the_gradients_of_torchrls_network(rows):
    torch.manual_seed(0)
    reference = MLP(in_features=7, out_features=5, num_cells=[16, 12], activation_class=nn.ReLU)
    ours = ReluMLP(7, 5, [16, 12])
    ours.load_state_dict(reference.state_dict())
    state, seed = torch.randn(rows, 4), torch.randn(rows, 5)
    results = []
    for network in (ours, reference):
        x = state.clone().requires_grad_()
        action = x[:, :3].sin()  # depends on the other input, as an actor's would
        loss = (network(x, action) * seed).square().sum()
        (gradient,) = torch.autograd.grad(loss, x, create_graph=True)
        assert gradient.requires_grad
        penalty = (gradient.norm(dim=-1) - 1).square().mean()
        second = torch.autograd.grad(penalty, [x, *network.parameters()])
        results.append([gradient.detach(), *second])
    for mine, expected in zip(*results, strict=True):
        scale = expected.abs().max().item()
        torch.testing.assert_close(mine, expected, rtol=0, atol=1e-4 * max(scale, 1e-3))


def test_first_and_second_derivatives_against_finite_differences():
    torch.manual_seed(0)
    weights = [torch.randn(2, 4, 3).double(), torch.randn(2, 2, 4).double()]
    biases = [torch.randn(2, 4).double(), torch.randn(2, 2).double()]
    inputs = [torch.randn(3, 2).double(), torch.randn(3, 1).double()]
    tensors = [x.requires_grad_() for x in (*inputs, *weights, *biases)]

    def call(*x):
        return relu_mlp(x[:2], x[2:4], x[4:])

    assert torch.autograd.gradcheck(call, tensors)
    assert torch.autograd.gradgradcheck(call, tensors)


@pytest.mark.parametrize("rows", [5, 80])
def test_under_autocast_the_network_is_torchrls(rows):
    torch.manual_seed(0)
    ours = ReluMLP(7, 5, [16, 12])
    reference = MLP(in_features=7, out_features=5, num_cells=[16, 12], activation_class=nn.ReLU)
    reference.load_state_dict(ours.state_dict())
    x = torch.randn(rows, 7)
    gradients = []
    for network in (ours, reference):
        with torch.autocast("cpu", dtype=torch.bfloat16):
            output = network(x)
        assert output.dtype == torch.bfloat16
        gradients.append([output, *torch.autograd.grad(output.sum(), list(network.parameters()))])
    for mine, expected in zip(*gradients, strict=True):
        assert torch.equal(mine, expected)


def test_autocast_is_asked_for_each_device():
    x = torch.zeros(2, 3)
    assert not module.autocast_enabled(x)
    assert not module.autocast_enabled(x.to("meta"))
    with torch.autocast("cpu", dtype=torch.bfloat16):
        assert module.autocast_enabled(x)
        assert not module.autocast_enabled(x.to("meta"))
        with torch.autocast("cpu", enabled=False):
            assert not module.autocast_enabled(x)


def test_gaps_in_memory_change_nothing():
    weights, biases = stacked(networks(2))
    state, action = torch.randn(7, 128).mT, torch.randn(128, 9)[:, ::2][:, :3]
    state = state[:, :4]
    dense = relu_mlp([state.contiguous(), action.contiguous()], weights, biases)
    torch.testing.assert_close(relu_mlp([state, action], weights, biases), dense)


@pytest.mark.parametrize("grad", [True, False])
def test_nan_comes_out_where_it_went_in(grad):
    weights, biases = stacked(networks(2))
    x = torch.randn(80, 7)
    x[3, 2] = float("nan")
    with torch.set_grad_enabled(grad):
        output = relu_mlp([x], weights, biases)
    assert output[:, 3].isnan().all()
    assert output[:, :3].isfinite().all()


def test_other_dtypes_and_vmap():
    net = ReluMLP(7, 5, (16,)).double()
    x = torch.randn(70, 7, dtype=torch.float64)
    expected = nn.Sequential(*net)(x)
    torch.testing.assert_close(net(x), expected)
    torch.testing.assert_close(torch.vmap(net)(x), expected)


def test_the_loss_at_a_batch_large_enough_for_either_library():
    assert_same_as_torchrl(make_batch(96), critic=relu_mlp_critic)
