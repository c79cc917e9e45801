"""`DepthNoise`: the noise and the missing pixels of a real depth camera."""

import torch
from tensordict import NestedKey, TensorDictBase
from torchrl.data import TensorSpec, Unbounded

from modpush._arguments import checked_arguments
from modpush._checks import check_dtype
from modpush._keys import check_spec_has, read_key
from modpush._transforms import StatelessTransform
from modpush._types import Fraction, NonNegativeLength

__all__ = ["DepthNoise"]


class DepthNoise(StatelessTransform):
    """Adds noise to a depth image and removes pixels from it, independently in every step.

    Insert it before the transforms that read the image:
    `env.insert_transform(0, DepthNoise(sigma=0.002))`. Random numbers are torch's, so that
    `torch.manual_seed` repeats them.

    Args:
        sigma: Standard deviation of the normal noise on each pixel [m].
        dropout: Share of pixels without a measurement, in [0, 1]. They read 0, which stands for
            "nothing seen" in all of modpush.
        depth_key: Read and written, `[..., 1, H, W]` float32 [m].

    Raises:
        ValueError: If a number is out of its range.
        KeyError: If the image is missing.
    """

    @checked_arguments
    def __init__(
        self,
        sigma: NonNegativeLength = 0.0,
        dropout: Fraction = 0.0,
        *,
        depth_key: NestedKey = "depth",
    ) -> None:
        super().__init__(in_keys=[depth_key], out_keys=[depth_key])
        self.sigma, self.dropout = sigma, dropout
        self.depth_key = depth_key

    def _call(self, next_tensordict: TensorDictBase) -> TensorDictBase:
        depth = read_key(next_tensordict, self.depth_key)
        check_dtype(repr(self.depth_key), depth, torch.float32)
        if self.sigma > 0:
            noisy = (depth + self.sigma * torch.randn_like(depth)).clamp_min(0.0)
            depth = torch.where(depth > 0, noisy, depth)  # 0 stays: nothing is seen there
        if self.dropout > 0:
            depth = depth.masked_fill(torch.rand_like(depth) < self.dropout, 0.0)
        return next_tensordict.set(self.depth_key, depth)

    def transform_observation_spec(self, observation_spec: TensorSpec) -> TensorSpec:
        """With noise the table may seem to be farther away than it is."""
        check_spec_has(observation_spec, [self.depth_key])
        if self.sigma > 0:
            spec = observation_spec[self.depth_key]
            observation_spec[self.depth_key] = Unbounded(
                shape=spec.shape, dtype=spec.dtype, device=spec.device
            )
        return observation_spec
