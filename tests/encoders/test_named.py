"""Encoders by name, by file, by "module:name" and as objects."""

import pytest
import torch
from torch import nn

from modpush.encoders import ConvEncoder, DepthVAE, RayScan, make_encoder

HERE = "tests.encoders.test_named"


class Mean(nn.Module):
    """An encoder that knows nothing of the library."""

    latent_dim = 1

    def forward(self, window):
        return window.mean((1, 2, 3))[:, None]


mean = Mean()


def make_mean():
    return Mean()


@pytest.mark.parametrize(
    ("name", "kind"), [("vae", DepthVAE), ("rays", RayScan), ("conv", ConvEncoder)]
)
def test_encoders_have_names(name, kind):
    encoder = make_encoder(name)
    assert isinstance(encoder, kind)
    assert encoder(torch.zeros(2, 1, 64, 64)).shape == (2, encoder.latent_dim)


@pytest.mark.parametrize(
    "encoder", [mean, Mean, make_mean, f"{HERE}:mean", f"{HERE}:Mean", f"{HERE}:make_mean"]
)
def test_an_encoder_of_your_own_is_found_in_every_form(encoder):
    assert type(make_encoder(encoder)).__name__ == "Mean"


@pytest.mark.parametrize("form", [str, lambda path: path])
def test_a_file_of_an_autoencoder_is_read(tmp_path, form):
    vae = DepthVAE(5, (2, 2, 2, 2), (2, 2, 2, 2)).eval()
    vae.save(tmp_path / "mine.safetensors")
    window = torch.rand(2, 1, 64, 64)
    encoder = make_encoder(form(tmp_path / "mine.safetensors"))
    assert torch.equal(encoder(window), vae(window))
