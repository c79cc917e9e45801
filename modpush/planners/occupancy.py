"""`OccupancyGrid`: from a depth image to the cells that the object's centre cannot be in."""

import math

import torch
from tensordict import NestedKey, TensorDictBase
from torch import Tensor
from torchrl.data import Binary, Bounded, TensorSpec
from torchrl.envs import Transform

from modpush.geometry.camera import Camera
from modpush.planners.inflation import radius_per_scene
from modpush.planners.kernels.bit_grid import words_per_row
from modpush.planners.occupancy_map import OccupancyMap


class OccupancyGrid(Transform):
    """Writes the cells that the object's centre cannot be in, seen from above.

    Cells are those of `Camera` on the table. Object and robot do not block; the rest does where
    it is higher than `min_height`, inflated by the circumscribed radius of the object's footprint.
    A map is inflated again only when the cells before inflation change, scene by scene.

    What stands where object or robot hide the view is remembered from the step before, in
    `blocked_key`. Only what is lower than the object can hide behind it. If a later transform drops
    that key, nothing is remembered and such cells count as free while they are hidden.

    Args:
        object_radius: Circumscribed radius of the object's footprint [m]; the default is the small
            cube's.
        object_radius_key: Read the radius from here instead, `[..., 1]` float [m].
        camera: The camera and its grid.
        min_height: What is lower does not block [m].
        upright: See `OccupancyMap`.
        depth_key: Read, `[..., 1, H, W]` float32 [m].
        segmentation_key: Read, `[..., 1, H, W]` uint8. None: the object is what stands within its
            radius of its pose, and a robot in the image blocks.
        object_pose_key: Read without a segmentation, `[..., 3]` (x, y, yaw) [m, rad].
        occupancy_key: Written, `[..., 1, H, W]` bool, True where blocked.
        blocked_key: Written and read back, `[..., H, 8 * ceil(W / 64)]` uint8: cells before
            inflation, as bits.

    Raises:
        ValueError: If `object_radius` is negative or not finite.
    """

    def __init__(
        self,
        object_radius: float = 0.025 * math.sqrt(2.0),
        *,
        object_radius_key: NestedKey | None = None,
        camera: Camera | None = None,
        min_height: float = 0.013,
        upright: bool = True,
        depth_key: NestedKey = "depth",
        segmentation_key: NestedKey | None = "segmentation",
        object_pose_key: NestedKey = "object_pose",
        occupancy_key: NestedKey = "occupancy",
        blocked_key: NestedKey = "blocked_bits",
    ) -> None:
        radius_per_scene(object_radius, 1, "OccupancyGrid")
        self.object_radius = object_radius
        self.object_radius_key = object_radius_key
        self.depth_key = depth_key
        self.segmentation_key = segmentation_key
        self.object_pose_key = object_pose_key
        self.occupancy_key = occupancy_key
        self.blocked_key = blocked_key
        optional = segmentation_key if segmentation_key is not None else object_pose_key
        in_keys = [depth_key, optional]
        if object_radius_key is not None:
            in_keys.append(object_radius_key)
        super().__init__(in_keys=in_keys, out_keys=[occupancy_key, blocked_key])
        self.map = OccupancyMap(camera, min_height, upright)

    @property
    def camera(self) -> Camera:
        """The camera and its grid."""
        return self.map.camera

    def _write(self, tensordict: TensorDictBase, previous: Tensor | None) -> TensorDictBase:
        for key in self.in_keys:
            if tensordict.get(key, None) is None:
                raise KeyError(
                    f"OccupancyGrid: {key!r} is missing; there is "
                    f"{sorted(map(str, tensordict.keys(True, True)))}."
                )
        depth = tensordict.get(self.depth_key)
        lead = depth.shape[:-3]
        segmentation = position = None
        if self.segmentation_key is not None:
            segmentation = tensordict.get(self.segmentation_key).reshape(-1, *depth.shape[-2:])
        else:
            position = tensordict.get(self.object_pose_key)[..., :2].reshape(-1, 2)
        radius: float | Tensor = self.object_radius
        if self.object_radius_key is not None:
            radius = tensordict.get(self.object_radius_key).reshape(-1)
        occupancy, blocked = self.map(
            depth.reshape(-1, *depth.shape[-2:]),
            radius,
            segmentation,
            position,
            None if previous is None else previous.reshape(-1, *previous.shape[-2:]),
        )
        tensordict.set(self.occupancy_key, occupancy.reshape(*lead, 1, *occupancy.shape[1:]))
        tensordict.set(self.blocked_key, blocked.reshape(*lead, *blocked.shape[1:]))
        return tensordict

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        # TorchRL puts back the old values of scenes that are not being reset.
        return self._write(tensordict_reset, None)

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        return self._write(next_tensordict, tensordict.get(self.blocked_key, None))

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Write the grid for stored data; cells that were remembered stay so."""
        return self._write(tensordict, tensordict.get(self.blocked_key, None))

    def transform_observation_spec(self, observation_spec: TensorSpec) -> TensorSpec:
        """Add the two written keys."""
        height, width = self.camera.height, self.camera.width
        lead, device = observation_spec.shape, observation_spec.device
        observation_spec[self.occupancy_key] = Binary(
            shape=(*lead, 1, height, width), dtype=torch.bool, device=device
        )
        observation_spec[self.blocked_key] = Bounded(
            low=0,
            high=255,
            shape=(*lead, height, 8 * words_per_row(width)),
            dtype=torch.uint8,
            device=device,
        )
        return observation_spec
