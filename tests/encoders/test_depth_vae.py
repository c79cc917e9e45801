"""The autoencoder: shapes, its loss by hand, files, and what the shipped one keeps."""

import pytest
import torch
from tensordict import TensorDict
from torch.distributions import Bernoulli, Independent, Normal, kl_divergence

from modpush.encoders import DepthVAE, VAELoss
from tests.encoders.scenes import CUBE, moved, window_of

TINY = {"latent_dim": 5, "encoder_widths": (2, 3, 4, 5), "decoder_widths": (5, 4, 3, 2)}
BAR = (0.10, 0.06, 0.06)


@pytest.fixture(scope="module")
def shipped():
    return DepthVAE.from_pretrained()


def test_layers_are_the_paper_s():
    vae = DepthVAE()
    down = [type(layer).__name__ for layer in vae.encoder]
    up = [type(layer).__name__ for layer in vae.decoder]
    assert down.count("Conv2d") == down.count("BatchNorm2d") == down.count("ReLU") == 4
    assert down.index("MaxPool2d") == 3  # after the first convolution, its norm and its ReLU
    assert down[down.index("AvgPool2d") - 3] == "Conv2d"
    assert down[: down.index("AvgPool2d")].count("Conv2d") == 3
    assert up.count("ConvTranspose2d") == 6
    assert vae.latent_dim == 32


def test_the_latent_is_the_mean_unless_a_sample_is_asked_for():
    window = torch.rand(2, 1, 64, 64)
    vae = DepthVAE(**TINY).eval()
    assert torch.equal(vae(window), vae.encode(window)[0])
    vae.sample = True
    assert not torch.equal(vae(window), vae(window))


def test_the_loss_is_the_negative_evidence_bound():
    torch.manual_seed(0)
    vae = DepthVAE(**TINY).eval()
    window = (torch.rand(4, 1, 64, 64) > 0.8).float()
    data = TensorDict(window=window)
    torch.manual_seed(1)
    losses = VAELoss(vae, kl_weight=0.5)(data)
    torch.manual_seed(1)
    mean, std = vae.encode(window)
    logits = vae.decode(mean + std * torch.randn_like(std))
    likelihood = Independent(Bernoulli(logits=logits), 3).log_prob(window).mean()
    kl = kl_divergence(Normal(mean, std), Normal(0.0, 1.0))
    torch.testing.assert_close(losses["loss_reconstruction"], -likelihood)
    torch.testing.assert_close(losses["kl"], kl.sum(1).mean())
    torch.testing.assert_close(losses["kl_per_latent"], kl.mean(0))
    torch.testing.assert_close(losses["loss_kl"], 0.5 * kl.sum(1).mean())
    assert list(data.keys()) == ["window"]


def test_the_loss_trains_every_weight_and_follows_a_renamed_key():
    loss = VAELoss(DepthVAE(**TINY))
    loss.set_keys(window=("eye", "window"))
    losses = loss(TensorDict({("eye", "window"): torch.rand(4, 1, 64, 64)}))
    (losses["loss_reconstruction"] + losses["loss_kl"]).backward()
    for name, parameter in loss.named_parameters():
        assert parameter.grad is not None, name
        assert parameter.grad.isfinite().all(), name
    assert not losses["kl_per_latent"].requires_grad


def test_what_is_saved_comes_back(tmp_path):
    vae = DepthVAE(**TINY).eval()
    vae.save(tmp_path / "new" / "vae.safetensors", {"by": "a test"})
    back = DepthVAE.from_pretrained(tmp_path / "new" / "vae.safetensors")
    window = torch.rand(2, 1, 64, 64)
    assert torch.equal(back(window), vae(window))
    assert not back.training
    assert not back.sample
    DepthVAE(**TINY, sample=True).save(tmp_path / "new" / "vae.safetensors")
    assert DepthVAE.from_pretrained(tmp_path / "new" / "vae.safetensors").sample
    assert [path.name for path in (tmp_path / "new").iterdir()] == ["vae.safetensors"]


def test_weights_are_taken_over_whole_or_not_at_all():
    vae, other = DepthVAE(**TINY), DepthVAE()
    before = {key: value.clone() for key, value in vae.state_dict().items()}
    with pytest.raises(ValueError, match="another architecture"):
        vae.load_weights(other.state_dict())
    wrong = vae.state_dict() | {"decoder.0.weight": vae.state_dict()["decoder.0.weight"].int()}
    with pytest.raises(
        ValueError, match=r"decoder.0.weight must be torch.float32, got torch.int32"
    ):
        vae.load_weights(wrong)
    with pytest.raises(ValueError, match=r"decoder.0.bias must be finite"):
        vae.load_weights(
            vae.state_dict() | {"decoder.0.bias": vae.state_dict()["decoder.0.bias"] / 0.0}
        )
    missing = other.state_dict()
    missing.pop("encoder.0.weight")
    with pytest.raises(ValueError, match=r"missing \['encoder.0.weight'\]"):
        other.load_weights(missing)
    assert all(torch.equal(before[key], value) for key, value in vae.state_dict().items())


@torch.no_grad()
def test_the_shipped_one_keeps_obstacles_where_they_are(shipped):
    obstacles = [(BAR, (0.67, 0.03, 0.4)), (CUBE, (0.54, -0.06, 0.2))]
    window = window_of(obstacles, (CUBE, (0.60, 0.0, 0.0)))
    shown, true = shipped.reconstruct(window) > 0.5, window > 0.5
    assert (shown & true).sum() / (shown | true).sum() > 0.85
    assert (shipped.reconstruct(torch.zeros_like(window)) < 0.5).all()


@torch.no_grad()
def test_empty_and_blocked_windows_have_far_apart_latents(shipped):
    ends = shipped(torch.stack([torch.zeros(1, 64, 64), torch.full((1, 64, 64), 0.75)]))
    some = [
        window_of([(BAR, (0.60 + dx, dy, yaw))], (CUBE, (0.60, 0.0, 0.0)))
        for dx, dy, yaw in ((0.08, 0.0, 0.0), (0.0, 0.08, 0.5), (-0.07, 0.06, 1.0))
    ]
    spread = shipped(torch.cat(some)).std(0).norm()
    assert (ends[0] - ends[1]).norm() > spread


@torch.no_grad()
def test_turning_and_shifting_the_whole_scene_hardly_moves_the_latent(shipped):
    obstacles = [(BAR, (0.08, 0.02, 0.5)), (CUBE, (-0.05, -0.07, 0.1))]

    def latent(shift, turn, scene):
        placed = [moved(o, shift, turn) for o in scene]
        return shipped(window_of(placed, (CUBE, (*shift, turn))))

    here = latent((0.60, 0.0), 0.0, obstacles)
    there = [
        latent((0.60 + dx, dy), turn, obstacles)
        for dx, dy, turn in ((-0.1, 0.15, 0.4), (0.1, -0.2, -2.0), (0.0, 0.2, 3.0))
    ]
    another = latent((0.60, 0.0), 0.0, [moved(o, (0.0, 0.0), 0.5) for o in obstacles])
    apart = (another - here).norm()
    assert max((z - here).norm() for z in there) < 0.5 * apart


def test_the_loss_is_float32_and_close_when_the_layers_compute_in_bfloat16():
    found = []
    for reduced in (False, True):
        torch.manual_seed(0)
        loss = VAELoss(DepthVAE(4))
        batch = TensorDict(window=torch.rand(8, 1, 64, 64))
        with torch.autocast("cpu", torch.bfloat16, enabled=reduced):
            losses = loss(batch)
        assert all(value.dtype == torch.float32 for value in losses.values())
        (losses["loss_reconstruction"] + losses["loss_kl"]).backward()
        found.append((losses.detach(), torch.cat([p.grad.flatten() for p in loss.parameters()])))
    (exact, gradient), (rounded, other) = found
    for key in ("loss_reconstruction", "loss_kl"):
        torch.testing.assert_close(rounded[key], exact[key], rtol=0.01, atol=0.0)
    assert torch.cosine_similarity(gradient, other, dim=0) > 0.98
    assert not torch.equal(gradient, other)
