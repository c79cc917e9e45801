"""The depth cameras by name."""

from typing import Any

from modpush.envs.depth.analytic import AnalyticDepthCamera
from modpush.envs.depth.base import DepthCameraFactory
from modpush.parts import find_part

__all__ = ["DEPTH_CAMERAS", "find_depth_camera"]

DEPTH_CAMERAS: dict[str, DepthCameraFactory | str] = {
    "analytic": AnalyticDepthCamera,
    "sapien": "modpush.envs.engines.sapien.rendered_camera:RenderedDepthCamera",
}
"""The shipped depth cameras by name, or where they are."""


def find_depth_camera(depth: str | DepthCameraFactory) -> DepthCameraFactory:
    """Factory of a depth camera, by name, by `"module:name"`, or passed through.

    Raises:
        ValueError: If there is no such camera (the known ones are listed), or if it cannot be called.
    """
    found: Any = find_part("depth", find_part("depth", depth, DEPTH_CAMERAS), {})
    if not callable(found):
        raise ValueError(
            f"PushEnv: depth must be a DepthCamera's class or a function (scenes, arm_in_depth) -> "
            f"DepthCamera, got {found!r}."
        )
    return found
