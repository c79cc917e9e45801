"""Quality of a latent: reconstruction, active values, and probes; for `train_vae` and `report_vae`."""

from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import dataclass

import torch
from torch import Tensor, nn
from torch.nn.functional import binary_cross_entropy_with_logits

from modpush.encoders.base import evaluating
from modpush.encoders.vae.model import DepthVAE, kl_divergence

_BATCH = 512


@dataclass(frozen=True, kw_only=True)
class Quality:
    """Quality of a `DepthVAE` on a set of windows."""

    nll: float
    """Negative log-likelihood of the reconstruction from a sampled latent, per window [nat]."""
    kl: float
    """KL divergence from the prior, per window [nat]; `-(nll + kl)` is the ELBO."""
    loss: float
    """The training loss `nll + 0.5 kl` per window [nat]."""
    entropy: float
    """Lower bound of `nll`, the entropy of the windows' values, per window [nat]."""
    iou: float
    """Intersection over union of obstacle pixels (over 0.5) of windows and reconstructions, over all
    windows together."""
    mean_iou: float
    """Mean of the same over windows with such pixels, with equal weight for small obstacles."""
    iou_half: float
    """As `iou`, with pixels over 0.3, half an obstacle's height: a cube has the value 0.625, so that a
    reconstruction with an uncertain edge falls below 0.5 well inside it."""
    blank_false: float
    """Share of pixels over 0.5 in reconstructions of blank windows."""
    active: int
    """Number of latent values whose mean varies over the windows by more than 0.01 (variance; Burda et
    al. 2016)."""
    kl_per_latent: tuple[float, ...]
    """KL divergence of each value of the latent [nat]."""


def bernoulli_entropy(window: Tensor) -> Tensor:
    """Entropy of pixels taken as probabilities, summed over each window, `[B]` [nat].

    No decoder's negative log-likelihood goes below it: a bar of value 0.75 costs 0.56 nat a pixel
    even where it is reconstructed exactly.
    """
    return -(torch.xlogy(window, window) + torch.xlogy(1 - window, 1 - window)).flatten(1).sum(1)


@torch.no_grad()
def vae_quality(vae: DepthVAE, windows: Callable[[slice], Tensor], count: int) -> Quality:
    """Measure on `count` windows, in eval mode.

    Args:
        vae: The autoencoder to measure.
        windows: Function of a slice that returns `[n, 1, 64, 64]` float32, such as `WindowData.floats`.
        count: Number of windows.
    """
    device = next(vae.parameters()).device
    rows, means = [], []
    per_latent = torch.zeros(vae.latent_dim, device=device)
    false, blanks = 0.0, 0
    with evaluating(vae):
        for start in range(0, count, _BATCH):
            window = windows(slice(start, min(start + _BATCH, count))).to(device)
            mean, std = vae.encode(window)
            means.append(mean)
            kl = kl_divergence(mean, std)
            per_latent += kl.sum(0) / count
            logits = vae.decode(mean + std * torch.randn_like(std))
            reconstruction = vae.decode(mean).sigmoid()
            rows.append(_figures(window, logits, reconstruction, kl))
            blank = window.flatten(1).amax(1) == 0
            shown = reconstruction.flatten(1) > 0.5
            false, blanks = false + float(shown[blank].float().sum()), blanks + int(blank.sum())
    nll, kl, entropy, common, either, common_half, either_half, filled = torch.cat(rows).unbind(1)
    some = filled > 0
    return Quality(
        nll=nll.mean().item(),
        kl=kl.mean().item(),
        loss=(nll + 0.5 * kl).mean().item(),
        entropy=entropy.mean().item(),
        iou=(common.sum() / either.sum().clamp_min(1)).item(),
        mean_iou=(common[some] / either[some]).mean().item() if some.any() else float("nan"),
        iou_half=(common_half.sum() / either_half.sum().clamp_min(1)).item(),
        blank_false=false / max(blanks * windows(slice(0, 1)).numel(), 1),
        active=int((torch.cat(means).var(0) > 0.01).sum()),
        kl_per_latent=tuple(per_latent.tolist()),
    )


def _figures(window: Tensor, logits: Tensor, reconstruction: Tensor, kl: Tensor) -> Tensor:
    """Measurements of each window, `[B, 8]`, in the order in which `vae_quality` reads them."""
    nll = binary_cross_entropy_with_logits(logits, window, reduction="none").flatten(1).sum(1)
    overlaps = [*_overlap(reconstruction, window, 0.5), *_overlap(reconstruction, window, 0.3)]
    filled = (window.flatten(1) > 0.5).any(1).float()
    return torch.stack([nll, kl.sum(1), bernoulli_entropy(window), *overlaps, filled], 1)


def _overlap(a: Tensor, b: Tensor, threshold: float) -> tuple[Tensor, Tensor]:
    """Pixels over the threshold in both, and in either, `[B]` each."""
    one, other = a.flatten(1) > threshold, b.flatten(1) > threshold
    return (one & other).sum(1).float(), (one | other).sum(1).float()


@torch.no_grad()
def encode_all(
    encoder: Callable[[Tensor], Tensor], windows: Callable[[slice], Tensor], count: int
) -> Tensor:
    """Latents `[count, d]`, encoded in batches; arguments as in `vae_quality`."""
    starts = range(0, count, _BATCH)
    mode = evaluating(encoder) if isinstance(encoder, nn.Module) else nullcontext()
    with mode:
        return torch.cat([encoder(windows(slice(s, min(s + _BATCH, count)))) for s in starts])


def r_squared(predicted: Tensor, true: Tensor) -> float:
    """Share of the targets' variance that is predicted, over all of them together.

    Args:
        predicted: Predictions, `[N, T]`.
        true: Targets, `[N, T]`.
    """
    return 1.0 - ((predicted - true).square().sum() / (true - true.mean(0)).square().sum()).item()


def linear_probe(train: tuple[Tensor, Tensor], test: tuple[Tensor, Tensor]) -> float:
    """R² on the test part of least squares, fitted on the training part.

    Args:
        train: Latents `[N, d]` and targets `[N, T]`.
        test: The same of the test part.
    """
    one = [torch.cat([x, torch.ones_like(x[:, :1])], 1).double() for x, _ in (train, test)]
    weights = torch.linalg.lstsq(one[0], train[1].double()).solution
    return r_squared(one[1] @ weights, test[1].double())
