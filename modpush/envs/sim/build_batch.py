"""Building the scenes of a `PushEnv` for a device."""

from typing import Any

import torch

from modpush.envs.depth.base import DepthCameraFactory
from modpush.envs.depth.cameras import find_depth_camera
from modpush.envs.sim.batch import SceneBatch
from modpush.envs.sim.cpu_batch import CpuBatch
from modpush.envs.sim.cuda_batch import CudaBatch
from modpush.envs.sim.rendering import choose_render_backend

__all__ = ["build_batch"]


def build_batch(
    num_envs: int,
    device: torch.device,
    *,
    depth: str | DepthCameraFactory | None,
    arm_in_depth: bool,
    pictures: bool,
    **task: Any,
) -> SceneBatch:
    """Build scenes on a CPU or on CUDA, with a renderer only if it is needed.

    Args:
        num_envs: Number of scenes.
        device: Where they are simulated.
        depth: A depth camera by name, by `"module:name"` or as what makes it, or None.
        arm_in_depth: Whether the depth camera sees the arm.
        pictures: Whether `render` will be called.
        **task: Further arguments of `ClutterPushEnv`.

    Raises:
        ValueError: If there is no such depth camera; the known ones are listed.
        RuntimeError: If a renderer or a CUDA device is needed and there is none.
    """
    camera = None if depth is None else find_depth_camera(depth)
    rendering = pictures or getattr(camera, "needs_renderer", False)
    task["render_backend"] = choose_render_backend() if rendering else "none"
    batch = CudaBatch if device.type == "cuda" else CpuBatch
    return batch(num_envs, camera, arm_in_depth, **task)
