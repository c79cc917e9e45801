"""`WindowBytes`: the local window as bytes, for storage."""

from typing import Any

import torch
from tensordict import NestedKey, TensorDictBase
from torchrl.data import Bounded, TensorSpec

from modpush._checks import check_real
from modpush._keys import check_spec_has, read_key
from modpush._transforms import StatelessTransform

__all__ = ["WindowBytes"]


class WindowBytes(StatelessTransform):
    """Quantises the window to integers from 0 to 255, in a quarter of the memory.

    Networks with an encoder of their own read it and divide by 255.

    Args:
        window_key: Read, `[..., 1, S, S]` float32 in [0, 1]; written, the same shape, uint8.

    Raises:
        KeyError: If the window is missing.
        ValueError: If one of its values is not in [0, 1]; on a GPU this is not checked.
    """

    def __init__(self, window_key: NestedKey = "window") -> None:
        super().__init__(in_keys=[window_key], out_keys=[window_key])
        self.window_key = window_key

    def describe(self) -> dict[str, Any]:
        """The window is written as bytes."""
        return {"window_bytes": True}

    def _call(self, next_tensordict: TensorDictBase) -> TensorDictBase:
        window = read_key(next_tensordict, self.window_key)
        if window.dtype == torch.uint8:  # stored data, quantised already
            return next_tensordict
        check_real(repr(self.window_key), window)
        if window.numel() and window.device.type == "cpu":  # on a GPU the check would synchronise
            least, most = (float(value) for value in window.detach().aminmax())
            if not 0.0 <= least <= most <= 1.0:  # beyond, bytes would overflow
                raise ValueError(
                    f"WindowBytes: {self.window_key!r} must be finite and in [0, 1], got values from "
                    f"{least:g} to {most:g}."
                )
        return next_tensordict.set(self.window_key, (window * 255).round().to(torch.uint8))

    def transform_observation_spec(self, observation_spec: TensorSpec) -> TensorSpec:
        """Replace the window's spec by one of bytes."""
        check_spec_has(observation_spec, [self.window_key])
        observation_spec[self.window_key] = Bounded(
            low=0,
            high=255,
            shape=observation_spec[self.window_key].shape,
            dtype=torch.uint8,
            device=observation_spec.device,
        )
        return observation_spec
