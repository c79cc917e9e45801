"""The fused stack of layers against torch's own, with either library's products."""

import importlib
import itertools

import pytest
import torch
from torch import Tensor, nn

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
