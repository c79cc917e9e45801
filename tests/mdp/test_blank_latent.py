"""The latent relative to that of an empty window."""

import pytest
import torch
from torch import nn

from modpush.encoders import DepthVAE
from modpush.mdp import PushObservation, latent_entry
from tests.mdp.test_push_observation import make_state


class SmallEncoder(nn.Module):
    """An encoder of windows of 8 pixels, with a part that acts otherwise while training."""

    latent_dim, window_size = 3, 8

    def __init__(self):
        super().__init__()
        self.frozen = nn.BatchNorm2d(1).eval()
        self.rest = nn.Sequential(nn.Flatten(), nn.Linear(64, 3), nn.Dropout(0.5))

    def forward(self, window):
        return self.rest(self.frozen(window))


def observed(observe, latent):
    state = make_state(len(latent)).set("latent", latent)
    return observe(state)["observation"]


def test_an_empty_window_gives_zeros_and_others_the_difference():
    encoder = SmallEncoder().eval()
    blank = encoder(torch.zeros(1, 1, 8, 8)).detach()
    observe = PushObservation(entries=[("latent", latent_entry(encoder))])
    seen = observed(observe, torch.cat([blank, blank + 2.0]))
    torch.testing.assert_close(seen, torch.tensor([[0.0] * 3, [2.0] * 3]))


@pytest.mark.parametrize(
    "make_optimizer",
    [
        lambda parameters: torch.optim.SGD(parameters, lr=1.0),
        lambda parameters: torch.optim.Adam(parameters, lr=0.1),
        lambda parameters: torch.optim.Adam(parameters, lr=0.1, fused=True),
    ],
    ids=["sgd", "adam", "fused_adam"],
)
def test_it_follows_an_encoder_that_is_trained(make_optimizer):
    encoder = SmallEncoder()
    shift = latent_entry(encoder).shift
    before = shift()
    assert shift() is before
    optimiser = make_optimizer(encoder.parameters())
    encoder(torch.rand(4, 1, 8, 8)).sum().backward()
    optimiser.step()
    after = shift()
    assert not torch.equal(after, before)
    assert torch.equal(after, encoder.eval()(torch.zeros(1, 1, 8, 8))[0])
    assert not after.requires_grad
    encoder.load_state_dict({k: torch.zeros_like(v) for k, v in encoder.state_dict().items()})
    assert torch.equal(shift(), torch.zeros(3))


def test_the_shipped_encoder_s_is_that_of_one_window_of_zeros():
    encoder = DepthVAE.from_pretrained()
    with torch.no_grad():
        blank = encoder(torch.zeros(1, 1, 64, 64))[0]
    assert torch.equal(latent_entry(encoder).shift(), blank)


@pytest.mark.gpu
@pytest.mark.skipif(not torch.cuda.is_available(), reason="no CUDA device")
def test_an_encoder_on_a_gpu_is_asked_there():
    encoder = SmallEncoder().cuda()
    entry = latent_entry(encoder)
    assert entry.shift().is_cuda
    observe = PushObservation(entries=[("latent", entry)])
    assert observed(observe, torch.zeros(2, 3)).shape == (2, 3)
