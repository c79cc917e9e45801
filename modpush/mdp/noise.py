"""Noise of measurements, `PoseNoise` and `DepthNoise`, and the random numbers of an episode."""

import zlib
from typing import Any

import torch
from tensordict import NestedKey, TensorDictBase
from torch import Tensor
from torchrl.data import TensorSpec, Unbounded

from modpush._checks import check_dtype, check_spec_has, read_key
from modpush._transforms import DescribedTransform, StatelessTransform, add_unbounded
from modpush._types import Fraction, NonNegative, NonNegativeLength, Seed
from modpush._validation import checked_arguments

_RESOLUTION = 1e4  # starts are rounded to 0.1 mm and 0.1 mrad: processors differ in the last bits
_INCREMENT = 0x9E3779B97F4A7C15 - (1 << 64)
_FACTORS = (0xBF58476D1CE4E5B9 - (1 << 64), 0x94D049BB133111EB - (1 << 64))
_BITS = 24  # of a float32 in [0, 1)


class RandomStream:
    """Random numbers of each scene's episode, drawn from a state `[..., 1]` int64 in the tensordict.

    The first state of an episode is a hash of the object's pose and goal, so that an episode has the same
    numbers in a batch of any size, after any other episode and in every worker; environments that draw
    other episodes have other numbers. Another seed gives the same episodes other numbers, and streams
    under different keys are independent. Nothing is drawn from torch's generator.

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


class PoseNoise(DescribedTransform):
    """Writes a pose with uniform noise, independent in every step, beside the true one.

    The true state stays where it was, for reward, success and metrics; transforms that compute what
    the policy sees read the noisy pose by their `object_pose_key`.

    Args:
        position: Largest error of x and of y [m].
        yaw: Largest error of the yaw [rad].
        seed: Seed of the errors, see `RandomStream`.
        pose_key: Read, `[..., 3]` (x, y, yaw) [m, rad].
        noisy_pose_key: Written, `[..., 3]` float32.
        stream_key: Written, handed on at each step and read back, `[..., 1]` int64.
        object_pose_key: Read at a reset for the stream, `[..., 3]` (x, y, yaw) [m, rad].
        goal_position_key: Read at a reset for the stream, `[..., 2]` [m].

    Raises:
        ValueError: If a number is out of its range.
        KeyError: If a key that is read is missing.
    Source: MuJoCo Playground's `PandaRobotiqPushCube`: 1.5 cm, 7.5 degrees, uniform in every step.
    """

    @checked_arguments
    def __init__(
        self,
        position: NonNegativeLength = 0.0,
        yaw: NonNegative = 0.0,
        *,
        seed: Seed = 0,
        pose_key: NestedKey = "object_pose",
        noisy_pose_key: NestedKey = ("observed", "object_pose"),
        stream_key: NestedKey = "pose_noise_stream",
        object_pose_key: NestedKey = "object_pose",
        goal_position_key: NestedKey = "goal_position",
    ) -> None:
        self.position, self.yaw = position, yaw
        self.pose_key, self.noisy_pose_key = pose_key, noisy_pose_key
        self._stream = RandomStream(stream_key, seed, object_pose_key, goal_position_key)
        super().__init__(
            in_keys=list(dict.fromkeys([pose_key, *self._stream.in_keys])),
            out_keys=[noisy_pose_key, stream_key],
        )

    def describe(self) -> dict[str, Any]:
        """Largest errors."""
        return {"pose_noise": {"position": self.position, "yaw": self.yaw}}

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        # TorchRL puts back the old values of scenes that are not being reset.
        return self._write(tensordict_reset, self._stream.begin(tensordict_reset))

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        return self._write(next_tensordict, self._stream.advance(tensordict, next_tensordict))

    def _write(self, tensordict: TensorDictBase, state: Tensor) -> TensorDictBase:
        pose = read_key(tensordict, self.pose_key, 3).float()
        largest = pose.new_tensor([self.position, self.position, self.yaw])
        noise = (2.0 * self._stream.uniform(state, 3) - 1.0) * largest
        return tensordict.set(self.noisy_pose_key, pose + noise)

    def transform_observation_spec(self, observation_spec: TensorSpec) -> TensorSpec:
        """Add the noisy pose and the stream."""
        check_spec_has(observation_spec, self.in_keys)
        add_unbounded(observation_spec, self.noisy_pose_key, 3)
        self._stream.add_spec(observation_spec)
        return observation_spec


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
