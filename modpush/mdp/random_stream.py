"""`RandomStream`: random numbers of an episode whose state is in the tensordict."""

import zlib
from typing import Any

import torch
from tensordict import NestedKey, TensorDictBase
from torch import Tensor
from torchrl.data import TensorSpec, Unbounded

from modpush._keys import read_key

__all__ = ["RandomStream"]

_RESOLUTION = 1e4  # starts are rounded to 0.1 mm and 0.1 mrad: processors differ in the last bits
_INCREMENT = 0x9E3779B97F4A7C15 - (1 << 64)
_FACTORS = (0xBF58476D1CE4E5B9 - (1 << 64), 0x94D049BB133111EB - (1 << 64))
_BITS = 24  # of a float32 in [0, 1)


class RandomStream:
    """Random numbers of each scene's episode, drawn from a state `[..., 1]` int64 in the tensordict.

    The first state of an episode is a hash of the object's pose and goal, so that an episode has the
    same numbers in a batch of any size, after any other episode and in every worker; environments that
    draw other episodes have other numbers. Nothing is drawn from torch's generator.

    Args:
        key: Key of the state, written at a reset and at every step. It is hashed, too, so that streams
            under different keys are independent.
        seed: Another seed gives the same episodes other numbers.
        object_pose_key: Read at a reset, `[..., 3]` (x, y, yaw) [m, rad].
        goal_position_key: Read at a reset, `[..., 2]` [m].

    Source: Steele, Lea and Flood, "Fast Splittable Pseudorandom Number Generators" (2014), SplitMix64.
    """

    def __init__(
        self,
        key: NestedKey,
        seed: int,
        object_pose_key: NestedKey,
        goal_position_key: NestedKey,
    ) -> None:
        self.key, self._seed = key, seed
        self.in_keys = [object_pose_key, goal_position_key]

    def begin(self, tensordict: TensorDictBase) -> Tensor:
        """Write the first state of an episode, and return it."""
        start = torch.cat([read_key(tensordict, key) for key in self.in_keys], -1)
        state = torch.full_like(start[..., :1], self._seed, dtype=torch.long)
        name = torch.full_like(state, zlib.crc32(str(self.key).encode()))
        columns = (start * _RESOLUTION).round().long().split(1, -1)
        for column in (name, *columns):
            state = _mix(state + column + _INCREMENT)
        tensordict.set(self.key, state)
        return state

    def advance(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> Tensor:
        """Write the state of the next step, and return it."""
        state = _mix(read_key(tensordict, self.key, 1) + _INCREMENT)
        next_tensordict.set(self.key, state)
        return state

    def add_spec(self, spec: TensorSpec) -> None:
        """Add the state to an observation spec."""
        spec[self.key] = Unbounded((*spec.shape, 1), dtype=torch.long, device=spec.device)

    @staticmethod
    def uniform(state: Tensor, count: int) -> Tensor:
        """Numbers in [0, 1) of a state, `[..., count]` float32; the same at every call."""
        index = torch.arange(1, count + 1, device=state.device)
        return _shifted(_mix(state + index * _FACTORS[0]), 64 - _BITS).float() / 2.0**_BITS

    @classmethod
    def integer(cls, state: Tensor, low: int, high: int) -> Tensor:
        """A whole number of a state from `low` to `high`, both included, `[..., 1]` int64."""
        return low + (cls.uniform(state, 1) * (high - low + 1)).long()


def _mix(number: Any) -> Any:
    """A hash of 64-bit numbers; products wrap."""
    number = (number ^ _shifted(number, 30)) * _FACTORS[0]
    number = (number ^ _shifted(number, 27)) * _FACTORS[1]
    return number ^ _shifted(number, 31)


def _shifted(number: Any, bits: int) -> Any:
    """Shifted to the right without its sign."""
    return (number >> bits) & ((1 << (64 - bits)) - 1)
