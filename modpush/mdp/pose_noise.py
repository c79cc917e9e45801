"""`PoseNoise`: the error of a measured pose."""

from typing import Any

from tensordict import NestedKey, TensorDictBase
from torch import Tensor
from torchrl.data import TensorSpec

from modpush._arguments import checked_arguments
from modpush._keys import check_spec_has, read_key
from modpush._transforms import DescribedTransform, add_unbounded
from modpush._types import NonNegative, NonNegativeLength, Seed
from modpush.mdp.random_stream import RandomStream

__all__ = ["PoseNoise"]


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
