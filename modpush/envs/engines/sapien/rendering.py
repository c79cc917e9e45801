"""Search for a renderer, and the pose of SAPIEN's camera.

The renderer is looked for in a subprocess, since a broken Vulkan driver can take a process down.
"""

import functools
import math
import os
import subprocess
import sys
from typing import TYPE_CHECKING

from modpush.geometry.camera import Camera

if TYPE_CHECKING:
    import sapien

NO_RENDERER = (
    "No Vulkan device that SAPIEN can render with was found. Without one physics, "
    "depth='analytic', every state observation and drawn videos still work. To get one: install a "
    "GPU driver with Vulkan, or `make renderer` for a software device (Debian, Ubuntu) and export "
    "the VK_ICD_FILENAMES it prints."
)

_PROBE = """
import sapien
device = None
for name in ("cuda", "pci:0"):
    try:
        candidate = sapien.Device(name)
    except RuntimeError:
        continue
    if candidate.can_render():
        device = name
        break
if device is not None:
    sapien.render.RenderMaterial()
    sapien.Scene([sapien.physx.PhysxCpuSystem(), sapien.render.RenderSystem(sapien.Device(device))])
    print("found", device)
"""


def camera_pose(camera: Camera) -> "sapien.Pose":
    """Pose of a SAPIEN camera at the pinhole: its x axis looks down, its z axis points along +x."""
    import sapien

    return sapien.Pose(camera.position, [math.sqrt(0.5), 0.0, math.sqrt(0.5), 0.0])


def choose_render_backend() -> str:
    """ManiSkill's name for the renderer of this machine.

    Raises:
        RuntimeError: If there is none; the message says how to get one.
    """
    device = find_render_device()
    if device is None:
        raise RuntimeError(NO_RENDERER)
    return "gpu" if device == "cuda" else device


def find_render_device() -> str | None:
    """Name of the SAPIEN device to render with, `"cuda"` or `"pci:0"`, or None.

    The answer is kept for the life of the process, per Vulkan setting of the environment.
    """
    settings = tuple(os.environ.get(name) for name in ("VK_ICD_FILENAMES", "VK_DRIVER_FILES"))
    return _probe(settings)


@functools.cache
def _probe(settings: tuple[str | None, ...]) -> str | None:
    try:
        done = subprocess.run(
            [sys.executable, "-W", "ignore", "-c", _PROBE],
            capture_output=True,
            text=True,
            encoding="utf-8",
            timeout=120,
        )
    except subprocess.TimeoutExpired:
        return None
    for line in done.stdout.splitlines():
        if line.startswith("found "):
            return line.removeprefix("found ")
    return None
