"""Our draw against TorchRL's distribution: the same numbers from the same state of the generator."""

import pytest
import torch
from torchrl.modules import TanhNormal

from modpush.agents.tqc.tanh_normal import _TanhNormalSample, tanh_normal_rsample

BOUNDS = torch.tensor([-2.0, 0.0, 1.0]), torch.tensor([0.5, 1.0, 4.0])
SAME = torch.tensor(-3.0), torch.tensor(2.0)


def drawn(how, loc, scale, bounds):
    """Action, log-probability, and gradients of a mixture of both."""
    loc, scale = loc.clone().requires_grad_(), scale.clone().requires_grad_()
    torch.manual_seed(3)
    if how == "ours":
        action, log_prob = tanh_normal_rsample(loc, scale, bounds)
    else:
        low, high = (-1.0, 1.0) if bounds is None else bounds
        action, log_prob = TanhNormal(loc, scale, low=low, high=high).rsample_and_log_prob()
    weight = torch.linspace(-1, 2, action.numel(), dtype=loc.dtype).view_as(action)
    ((action * weight).sum() + (log_prob * weight[..., 0]).sum()).backward()
    return action.detach(), log_prob.detach(), loc.grad, scale.grad


@pytest.mark.parametrize("shape", [(3,), (40, 3), (4, 5, 3)])
@pytest.mark.parametrize("bounds", [None, BOUNDS, SAME], ids=["unit", "bounds", "one for all"])
@pytest.mark.parametrize(("dtype", "relative"), [(torch.float32, 3e-6), (torch.float64, 1e-12)])
def test_equals_torchrls_distribution(shape, bounds, dtype, relative):
    torch.manual_seed(0)
    loc, scale = torch.randn(shape, dtype=dtype), torch.rand(shape, dtype=dtype) + 0.1
    bounds = None if bounds is None else tuple(bound.to(dtype) for bound in bounds)
    ours, theirs = (drawn(how, loc, scale, bounds) for how in ("ours", "torchrl"))
    for mine, other in zip(ours, theirs, strict=True):
        assert mine.shape == other.shape
        torch.testing.assert_close(mine, other, rtol=relative, atol=relative)


def test_saturated_actions_stay_inside_and_finite():
    loc, scale = torch.tensor([[30.0, -30.0, 0.0]]), torch.tensor([[0.1, 5.0, 1e-6]])
    ours, theirs = (drawn(how, loc, scale, None) for how in ("ours", "torchrl"))
    assert (ours[0].abs() < 1).all()
    # Not the gradient to the scale: at 1e-6 TorchRL's is the difference of two large numbers.
    for mine, other in zip(ours[:3], theirs[:3], strict=True):
        assert mine.isfinite().all()
        torch.testing.assert_close(mine, other, rtol=1e-5, atol=1e-5)


def test_first_and_second_derivatives_against_finite_differences():
    torch.manual_seed(0)
    loc = torch.randn(4, 3, dtype=torch.float64, requires_grad=True)
    scale = (torch.rand(4, 3, dtype=torch.float64) + 0.2).requires_grad_()
    noise = torch.randn(4, 3, dtype=torch.float64)
    assert torch.autograd.gradcheck(_TanhNormalSample.apply, (loc, scale, noise))
    assert torch.autograd.gradgradcheck(_TanhNormalSample.apply, (loc, scale, noise))
