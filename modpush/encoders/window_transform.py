"""The local window around the object as TorchRL transforms: `EgocentricWindow`, `WindowBytes`."""

from typing import Any

import torch
from tensordict import NestedKey, TensorDictBase
from torch import Tensor
from torchrl.data import Bounded, TensorSpec

from modpush._checks import check_finite, check_real, check_spec_has, read_key
from modpush._transforms import StatelessTransform
from modpush._types import Count, Positive
from modpush._validation import checked_arguments
from modpush.encoders.window import (
    MAX_HEIGHT,
    METRES_PER_PIXEL,
    WINDOW_SIZE,
    Outside,
    check_max_height,
    egocentric_window,
)
from modpush.geometry.camera import Camera
from modpush.geometry.frames import Frame, frame_yaw


class EgocentricWindow(StatelessTransform):
    """Writes the height map around the object, with object and robot removed.

    Up in the window (towards row 0) is +x of the frame, left (towards column 0) is +y, the object's
    centre is in the middle. See `egocentric_window` for what a value means.

    Args:
        frame: Axes of the window: the object's own (`"object"`, the paper's), x from the object to
            the present sub-goal (`"path"`; where the two coincide, the base frame's), or the robot
            base's (`"base"`).
        size: Side of the window [px].
        outside: This and the following four are arguments of `egocentric_window`.
        max_height: See there [m].
        upright: See there.
        camera: See there.
        metres_per_pixel: See there [m].
        depth_key: Read, `[..., 1, H, W]` float32 [m].
        segmentation_key: Read, `[..., 1, H, W]` uint8: 0 table, 1 pushed object, 2 obstacle, 3
            robot. None removes nothing.
        object_pose_key: Read, `[..., 3]` (x, y, yaw) in the base frame [m, rad].
        subgoal_key: Read with `frame="path"`, `[..., 2]` in the base frame [m].
        window_key: Written, `[..., 1, size, size]` float32 in [0, 1], 0 is free.

    Raises:
        ValueError: For options that are unknown or out of range.
    Source: Sec. IV-A of the paper.
    """

    @checked_arguments
    def __init__(
        self,
        frame: Frame = "object",
        size: Count = WINDOW_SIZE,
        outside: Outside = "free",
        max_height: Positive = MAX_HEIGHT,
        *,
        upright: bool = True,
        camera: Camera | None = None,
        metres_per_pixel: Positive = METRES_PER_PIXEL,
        depth_key: NestedKey = "depth",
        segmentation_key: NestedKey | None = "segmentation",
        object_pose_key: NestedKey = "object_pose",
        subgoal_key: NestedKey = "subgoal",
        window_key: NestedKey = "window",
    ) -> None:
        self.camera = camera or Camera()
        check_max_height(max_height, self.camera)
        self.metres_per_pixel = metres_per_pixel
        self.frame, self.size, self.outside = frame, size, outside
        self.max_height, self.upright = max_height, upright
        self.depth_key, self.segmentation_key = depth_key, segmentation_key
        self.object_pose_key, self.subgoal_key = object_pose_key, subgoal_key
        self.window_key = window_key
        in_keys = [depth_key, object_pose_key]
        if segmentation_key is not None:
            in_keys.append(segmentation_key)
        if frame == "path":
            in_keys.append(subgoal_key)
        super().__init__(in_keys=in_keys, out_keys=[window_key])

    def describe(self) -> dict[str, Any]:
        """Frame, size, scale, and which heights are shown."""
        names = ("frame", "size", "metres_per_pixel", "outside", "max_height", "upright")
        return {"window": {name: getattr(self, name) for name in names}}

    def _pose(self, tensordict: TensorDictBase) -> Tensor:
        """`[B, 3]` of the window's frame."""
        pose = read_key(tensordict, self.object_pose_key, 3).reshape(-1, 3)
        subgoal = None
        if self.frame == "path":
            subgoal = read_key(tensordict, self.subgoal_key, 2).reshape(-1, 2)
        return torch.cat([pose[:, :2], frame_yaw(self.frame, pose, subgoal)], -1)

    def _call(self, next_tensordict: TensorDictBase) -> TensorDictBase:
        expected = (1, self.camera.height, self.camera.width)
        depth = read_key(next_tensordict, self.depth_key, *expected)
        labels = None
        if self.segmentation_key is not None:
            labels = read_key(next_tensordict, self.segmentation_key, *expected)
            labels = labels.reshape(-1, *expected[1:])
        pose = self._pose(next_tensordict)
        try:
            window = egocentric_window(
                depth.reshape(-1, *expected[1:]),
                labels,
                pose,
                size=self.size,
                max_height=self.max_height,
                outside=self.outside,
                upright=self.upright,
                camera=self.camera,
                metres_per_pixel=self.metres_per_pixel,
            )
        except ValueError:  # the function checks the pose without knowing its key
            check_finite(f"{self.object_pose_key!r} or sub-goal", pose)
            raise
        next_tensordict.set(self.window_key, window.reshape(*depth.shape[:-3], *window.shape[1:]))
        return next_tensordict

    def transform_observation_spec(self, observation_spec: TensorSpec) -> TensorSpec:
        """Add the window."""
        check_spec_has(observation_spec, self.in_keys)
        observation_spec[self.window_key] = Bounded(
            low=0.0,
            high=1.0,
            shape=(*observation_spec.shape, 1, self.size, self.size),
            dtype=torch.float32,
            device=observation_spec.device,
        )
        return observation_spec


class WindowBytes(StatelessTransform):
    """Quantises the window `[..., 1, S, S]` to integers from 0 to 255, in a quarter of the memory.

    Networks with an encoder of their own read it and divide by 255. A value outside [0, 1] is a
    ValueError; on a GPU this is not checked.
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
