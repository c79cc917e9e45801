"""`DepthVAE`: the paper's variational autoencoder of the local window."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from typing import Any

import torch
from tensordict import NestedKey, TensorDict, TensorDictBase
from torch import Tensor, nn
from torch.nn.functional import binary_cross_entropy_with_logits, softplus
from torchrl.objectives import LossModule

from modpush._checks import read_key
from modpush._state import check_weights
from modpush._types import Count, NonNegative, Positive
from modpush._validation import checked_arguments
from modpush.encoders.base import Encoder, check_window
from modpush.encoders.window import METRES_PER_PIXEL
from modpush.files import read_tensors, reading, write_tensors

_KIND, _VERSION = "modpush.DepthVAE", 2
_MIN_STD = 1e-4
_FINAL_SIDE = 4  # of the encoder's last and the decoder's first map [px]


class DepthVAE(Encoder):
    """Four convolutions to a normal latent, and six transposed ones to a Bernoulli window.

    Each convolution but the last is followed by batch norm and ReLU; max pooling after the first,
    average pooling after the third. As an encoder it returns the latent's mean; `encode` and `decode`
    give the distributions.

    Widths and strides are ours (the paper gives none), chosen by their speed: the window is halved early,
    the last map of the encoder is 4x4 (the authors' is 1x1), and the decoder has few channels where its
    maps are large. Weights are laid out channels-last, which halves the time on a CPU.

    Args:
        latent_dim: Number of values in a latent.
        encoder_widths: Channels of the four convolutions.
        decoder_widths: Channels of the maps of side 4, 8, 16 and 32.
        sample: Return a sample of the latent instead of its mean, as in the authors' code.
        metres_per_pixel: Side of the pixels of its windows on the table [m].

    Raises:
        ValueError: If a width or `latent_dim` is < 1, or there are not four of them.
    Source: Sec. IV-A of the paper.
    """

    @checked_arguments
    def __init__(
        self,
        latent_dim: Count = 32,
        encoder_widths: Sequence[Count] = (16, 32, 64, 96),
        decoder_widths: Sequence[Count] = (96, 64, 32, 16),
        sample: bool = False,
        metres_per_pixel: Positive = METRES_PER_PIXEL,
    ) -> None:
        super().__init__()
        for name, widths in (("encoder", encoder_widths), ("decoder", decoder_widths)):
            if len(widths) != 4:
                raise ValueError(
                    f"DepthVAE: {name}_widths must be four numbers, got {tuple(widths)}."
                )
        self.latent_dim, self.sample = latent_dim, sample
        self.metres_per_pixel = metres_per_pixel
        self.encoder_widths, self.decoder_widths = tuple(encoder_widths), tuple(decoder_widths)
        a, b, c, d = encoder_widths
        self.encoder = nn.Sequential(
            *_down(1, a, 5, stride=2),  # 32
            nn.MaxPool2d(2),  # 16
            *_down(a, b, 3, stride=1),
            *_down(b, c, 3, stride=2),  # 8
            nn.AvgPool2d(2),  # 4
            *_down(c, d, 3, stride=1),
            nn.Flatten(),
            nn.Linear(d * _FINAL_SIDE**2, 2 * latent_dim),
        )
        a, b, c, d = decoder_widths
        self.decoder = nn.Sequential(
            nn.Linear(latent_dim, a * _FINAL_SIDE**2),
            nn.Unflatten(1, (a, _FINAL_SIDE, _FINAL_SIDE)),
            nn.BatchNorm2d(a),
            nn.ReLU(),
            *_up(a, a, stride=1),
            *_up(a, b, stride=2),  # 8
            *_up(b, b, stride=1),
            *_up(b, c, stride=2),  # 16
            *_up(c, d, stride=2),  # 32
            nn.ConvTranspose2d(d, 1, 4, stride=2, padding=1),  # 64
        )
        self.to(memory_format=torch.channels_last)  # type: ignore[call-overload]

    def encode(self, window: Tensor) -> tuple[Tensor, Tensor]:
        """Mean and standard deviation of the latent, `[B, latent_dim]` each.

        Args:
            window: `[B, 1, 64, 64]` float32 in [0, 1].
        """
        check_window(window, self.window_size, values=False, batched=True)
        mean, spread = self.encoder(window).chunk(2, -1)
        return mean, softplus(spread) + _MIN_STD

    def decode(self, latent: Tensor) -> Tensor:
        """Logits of the window, `[B, 1, 64, 64]`; their sigmoid is the mean of the Bernoulli."""
        return self.decoder(latent)

    def forward(self, window: Tensor) -> Tensor:
        """The latent, `[B, latent_dim]`: its mean, or a sample with `sample=True`."""
        check_window(window, self.window_size, batched=True)
        mean, std = self.encode(window)
        return mean + std * torch.randn_like(std) if self.sample else mean

    def reconstruct(self, window: Tensor) -> Tensor:
        """The window decoded from the mean of its latent, `[B, 1, 64, 64]` in [0, 1]."""
        return self.decode(self.encode(window)[0]).sigmoid()

    def save(self, path: Path | str, card: Mapping[str, Any] | None = None) -> None:
        """Write weights and architecture to a safetensors file.

        Args:
            path: File that is written.
            card: Further entries of the file, such as data, command and figures; any JSON values.
        """
        config = {**self._architecture(), "card": dict(card or {})}
        write_tensors(path, self.state_dict(), _KIND, _VERSION, config)

    def _architecture(self) -> dict[str, Any]:
        return {
            "latent_dim": self.latent_dim,
            "encoder_widths": list(self.encoder_widths),
            "decoder_widths": list(self.decoder_widths),
            "sample": self.sample,
            "metres_per_pixel": self.metres_per_pixel,
        }

    @classmethod
    @checked_arguments
    def from_pretrained(cls, name_or_path: Path | str = "depth_vae") -> "DepthVAE":
        """Load a trained autoencoder, in eval mode.

        Args:
            name_or_path: Name of shipped weights (`modpush/weights/<name>.safetensors`, with a card
                beside it), or the path of a file of `save`.

        Raises:
            FileNotFoundError: If there is no such file; the message lists the shipped names.
            ValueError: If the file is damaged, of another kind, or its weights are not finite or do
                not fit the architecture it names.
        """
        path = shipped_weights().get(str(name_or_path), Path(name_or_path))
        if not path.is_file():
            raise FileNotFoundError(
                f"DepthVAE: no file {path} and no shipped weights of that name, which are "
                f"{sorted(shipped_weights())}."
            )
        with reading(path, _KIND):
            tensors, config = read_tensors(path, _KIND, _VERSION)
            architecture = {key: value for key, value in config.items() if key != "card"}
            with torch.device("meta"):  # without memory at first: a file may ask for any sizes
                check_weights("DepthVAE", cls(**architecture).float().state_dict(), tensors)
            vae = cls(**architecture).float()
            vae.load_weights(tensors)
        return vae.eval()

    def load_weights(self, tensors: Mapping[str, Tensor]) -> None:
        """Load all weights, or none of them.

        Raises:
            ValueError: If a weight is missing, unknown, of another shape or dtype, or not finite.
        """
        check_weights("DepthVAE", self.state_dict(), tensors)
        self.load_state_dict(dict(tensors))


def shipped_weights() -> dict[str, Path]:
    """Weights of `DepthVAE` that come with the package, by name."""
    folder = Path(str(files("modpush"))) / "weights"
    return {path.stem: path for path in folder.glob("depth_vae*.safetensors")}


def _down(inputs: int, outputs: int, kernel: int, stride: int) -> list[nn.Module]:
    padding = kernel // 2
    convolution = nn.Conv2d(inputs, outputs, kernel, stride, padding, bias=False)
    return [convolution, nn.BatchNorm2d(outputs), nn.ReLU()]


def _up(inputs: int, outputs: int, stride: int) -> list[nn.Module]:
    kernel = 3 if stride == 1 else 4
    convolution = nn.ConvTranspose2d(inputs, outputs, kernel, stride, padding=1, bias=False)
    return [convolution, nn.BatchNorm2d(outputs), nn.ReLU()]


def kl_divergence(mean: Tensor, std: Tensor) -> Tensor:
    """KL divergence from N(mean, std) to N(0, 1) of each number, shaped like both [nat]."""
    return 0.5 * (mean.square() + std.square() - 1.0) - std.log()


class VAELoss(LossModule):
    """Negative log-likelihood summed over pixels, and the weighted KL divergence; means over windows.

    Forward returns `loss_reconstruction` and `loss_kl` (to be added up), and without gradient `kl`
    (unweighted) and `kl_per_latent` `[latent_dim]`, all in nat.

    Args:
        vae: The autoencoder to train.
        kl_weight: Weight w of the divergence.

    Raises:
        ValueError: If it is not an autoencoder, or the weight is negative or not finite.
    Source: Sec. IV-A of the paper; w = 0.5 as in the authors' code.
    """

    @dataclass
    class _AcceptedKeys:
        window: NestedKey = "window"

    tensor_keys: _AcceptedKeys
    default_keys = _AcceptedKeys

    @checked_arguments
    def __init__(self, vae: DepthVAE, kl_weight: NonNegative = 0.5) -> None:
        super().__init__()
        self.vae = vae
        self.kl_weight = kl_weight
        self.out_keys = ["loss_reconstruction", "loss_kl", "kl", "kl_per_latent"]

    @property
    def in_keys(self) -> list[NestedKey]:
        """Keys that are read: the window."""
        return [self.tensor_keys.window]

    def _forward_value_estimator_keys(self, **kwargs: object) -> None:
        """Do nothing: there is no value to estimate."""

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Both losses of a batch of windows `[B, 1, 64, 64]`."""
        window = read_key(tensordict, self.tensor_keys.window)
        check_window(window, self.vae.window_size, batched=True)
        # In float32 whatever the networks compute in (`torch.autocast`).
        mean, std = (part.float() for part in self.vae.encode(window))
        logits = self.vae.decode(mean + std * torch.randn_like(std)).float()
        likelihood = binary_cross_entropy_with_logits(logits, window, reduction="sum")
        kl_per_latent = kl_divergence(mean, std).mean(0)
        kl = kl_per_latent.sum()
        return TensorDict(
            {
                "loss_reconstruction": likelihood / len(window),
                "loss_kl": self.kl_weight * kl,
                "kl": kl.detach(),
                "kl_per_latent": kl_per_latent.detach(),
            }
        )
