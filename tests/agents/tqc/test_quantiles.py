import pytest
import torch
from hypothesis import given, settings, strategies as st

from modpush.agents import quantile_huber, truncate_atoms
from modpush.agents.tqc.quantiles import _forward_numba, _forward_torch


def by_autograd(quantiles, targets):
    """Equations 12 and 13 of Kuznetsov et al. as they stand, differentiated by autograd."""
    delta = targets.unsqueeze(-2) - quantiles.unsqueeze(-1)
    n = quantiles.shape[-1]
    fractions = (2 * torch.arange(n, dtype=quantiles.dtype) + 1) / (2 * n)
    huber = torch.nn.functional.huber_loss(
        quantiles.unsqueeze(-1).expand_as(delta),
        targets.unsqueeze(-2).expand_as(delta),
        reduction="none",
    )
    weight = (fractions.unsqueeze(-1) - (delta < 0).to(delta.dtype)).abs()
    return (weight * huber).mean((-1, -2)), delta.abs().mean((-1, -2))


def test_two_quantiles_and_two_targets_by_hand():
    # Fractions 1/4 and 3/4. Quantile 0 against 0.5 and -2: 1/4 * 0.5^2/2 + 3/4 * (2 - 0.5) =
    # 0.03125 + 1.125; slopes 1/4 * 0.5 and 3/4 * -1. Quantile 1 against them, d = -0.5 and -3:
    # 1/4 * 0.125 + 1/4 * 2.5 = 0.03125 + 0.625; slopes 1/4 * -0.5 and 1/4 * -1.
    quantiles = torch.tensor([[[0.0, 1.0]]], requires_grad=True)
    loss, error = quantile_huber(quantiles, torch.tensor([[0.5, -2.0]]))
    loss.sum().backward()
    assert loss.item() == pytest.approx((0.03125 + 1.125 + 0.03125 + 0.625) / 4)
    assert error.item() == pytest.approx((0.5 + 2 + 0.5 + 3) / 4)
    expected = torch.tensor([[[-(0.125 - 0.75) / 4, -(-0.125 - 0.25) / 4]]])
    torch.testing.assert_close(quantiles.grad, expected)


@settings(deadline=None, max_examples=40)
@given(
    critics=st.integers(1, 3),
    batch=st.lists(st.integers(1, 4), min_size=1, max_size=2),
    n=st.integers(1, 26),
    m=st.integers(1, 35),
    seed=st.integers(0, 99),
)
@pytest.mark.parametrize("forward", [_forward_numba, _forward_torch])
def test_closed_form_equals_autograd_in_double_precision(forward, critics, batch, n, m, seed):
    generator = torch.Generator().manual_seed(seed)
    draw = {"generator": generator, "dtype": torch.float64}
    quantiles = 3 * torch.randn(critics, *batch, n, **draw)
    targets = 3 * torch.randn(*batch, m, **draw)
    quantiles.requires_grad_()
    expected_loss, expected_error = by_autograd(quantiles, targets)
    expected_loss.sum().backward()
    loss, gradient, error = forward(quantiles.detach(), targets)
    tolerance = {"rtol": 1e-10, "atol": 1e-12}
    torch.testing.assert_close(loss, expected_loss.detach(), **tolerance)
    torch.testing.assert_close(gradient, quantiles.grad, **tolerance)
    torch.testing.assert_close(error, expected_error.detach(), **tolerance)


def test_equal_values_have_zero_loss_and_zero_gradient():
    quantiles = torch.full((2, 3, 5), 0.7, requires_grad=True)
    loss, error = quantile_huber(quantiles, torch.full((3, 4), 0.7))
    loss.sum().backward()
    assert not loss.any()
    assert not error.any()
    assert not quantiles.grad.any()


def test_gradient_scales_with_what_flows_back():
    quantiles = torch.randn(2, 3, 5, requires_grad=True)
    targets, scale = torch.randn(3, 4), torch.randn(2, 3)
    (gradient,) = torch.autograd.grad(quantile_huber(quantiles, targets)[0].sum(), quantiles)
    loss, _ = quantile_huber(quantiles, targets)
    (scaled,) = torch.autograd.grad((scale * loss).sum(), quantiles)
    torch.testing.assert_close(scaled, gradient * scale.unsqueeze(-1))


def test_second_derivatives_are_autograds():
    torch.manual_seed(0)
    quantiles = torch.randn(2, 3, 5, dtype=torch.float64, requires_grad=True)
    targets = 2 * torch.randn(3, 4, dtype=torch.float64)
    weight = torch.rand(2, 3, dtype=torch.float64, requires_grad=True)
    results = []
    for function in (quantile_huber, by_autograd):
        loss = (function(quantiles, targets)[0] * weight).sum()
        (gradient,) = torch.autograd.grad(loss, quantiles, create_graph=True)
        penalty = gradient.pow(3).sum()
        results.append([gradient, *torch.autograd.grad(penalty, [quantiles, weight])])
    assert results[1][1].any()
    for mine, expected in zip(*results, strict=True):
        torch.testing.assert_close(mine, expected)


def test_half_precision_takes_the_tensor_path():
    loss, _ = quantile_huber(torch.ones(1, 2, 3).bfloat16(), torch.zeros(2, 4).bfloat16())
    assert loss.dtype == torch.bfloat16


@pytest.mark.parametrize("dtype", [torch.float32, torch.bfloat16])
def test_truncation_drops_the_highest_of_the_pool_not_of_each_critic(dtype):
    atoms = torch.tensor([[[5.0, 9.0, 7.0]], [[1.0, 3.0, 2.0]]], dtype=dtype)
    kept = truncate_atoms(atoms, 2)
    assert kept.tolist() == [[1.0, 2.0, 3.0, 5.0]]
