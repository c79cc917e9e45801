"""`ConvEncoder`: a network that is trained end to end."""

import torch
from torch import Tensor, nn

from modpush._types import Count
from modpush._validation import checked_arguments
from modpush.encoders.base import Encoder, as_floats, check_window
from modpush.encoders.window import WINDOW_SIZE


class ConvEncoder(Encoder):
    """Four strided convolutions, then a normalised and bounded latent, `[B, latent_dim]` in [-1, 1].

    It has no batch statistics and is the same in training and evaluation, since it is trained by the
    critic's loss on one batch and acts on another. Windows may be stored as bytes: uint8 values are
    divided by 255.

    Args:
        latent_dim: Number of values in a latent.
        width: Channels of the first convolution; the others have twice as many.
        window_size: Side of the windows [px].

    Raises:
        ValueError: If an argument is < 1.
    Source: DrQ's encoder (Kostrikov et al. 2020), with LayerNorm and tanh at the end.
    """

    @checked_arguments
    def __init__(
        self, latent_dim: Count = 32, width: Count = 16, window_size: Count = WINDOW_SIZE
    ) -> None:
        super().__init__()
        self.latent_dim, self.window_size = latent_dim, window_size
        layers: list[nn.Module] = []
        channels, side = 1, window_size
        for step in range(4):  # a window of 64: 32, 16, 8, 4
            wide = width if step == 0 else 2 * width
            layers += [nn.Conv2d(channels, wide, 3, stride=2, padding=1), nn.ReLU()]
            channels, side = wide, (side + 1) // 2
        self.layers = nn.Sequential(
            *layers,
            nn.Flatten(),
            nn.Linear(channels * side**2, latent_dim),
            nn.LayerNorm(latent_dim),
            nn.Tanh(),
        )
        # The convolutions compute in the memory format of their weights: on a CPU, with as few channels
        # as here, a batch takes 0.5 to 0.7 of the time in this one.
        self.layers.to(memory_format=torch.channels_last)  # type: ignore[call-overload]

    def forward(self, window: Tensor) -> Tensor:
        """Encode windows to `[B, latent_dim]`.

        Args:
            window: `[B, 1, S, S]` float32 in [0, 1], or uint8, in which 255 stands for 1.
        """
        window = as_floats(window)
        check_window(window, self.window_size, batched=True)
        return self.layers(window)
