"""`ConvEncoder`: trained end to end by the loss of whoever reads its latent."""

from torch import Tensor, nn

from modpush.encoders.base import Encoder, check_window

__all__ = ["ConvEncoder"]


class ConvEncoder(Encoder):
    """Four strided convolutions, then a normalised and bounded latent, `[B, latent_dim]` in [-1, 1].

    Holds no batch statistics: it does the same in training and evaluation, as a network must that
    is trained by the critic's loss on one batch and acts on another.

    Args:
        latent_dim: Numbers in a latent.
        width: Channels of the first convolution; the others have twice as many.

    Raises:
        ValueError: If one of them is < 1.
    Source: the shape of DrQ's encoder (Kostrikov et al. 2020): LayerNorm and tanh at the end.
    """

    def __init__(self, latent_dim: int = 32, width: int = 16) -> None:
        super().__init__()
        if latent_dim < 1 or width < 1:
            raise ValueError(
                f"ConvEncoder: latent_dim and width must be >= 1, got {latent_dim} and {width}."
            )
        self.latent_dim = latent_dim
        layers: list[nn.Module] = []
        channels = 1
        for step in range(4):  # 64 -> 32 -> 16 -> 8 -> 4
            wide = width if step == 0 else 2 * width
            layers += [nn.Conv2d(channels, wide, 3, stride=2, padding=1), nn.ReLU()]
            channels = wide
        self.layers = nn.Sequential(
            *layers,
            nn.Flatten(),
            nn.Linear(channels * 16, latent_dim),
            nn.LayerNorm(latent_dim),
            nn.Tanh(),
        )

    def forward(self, window: Tensor) -> Tensor:
        """Encode `[B, 1, 64, 64]` windows to `[B, latent_dim]`."""
        check_window(window, self.window_size, "ConvEncoder", values=False)
        return self.layers(window)
