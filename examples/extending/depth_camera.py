"""A depth camera of your own: the ray-cast one with noise that grows with the distance.

    python examples/extending/depth_camera.py

Contract: a `DepthCamera` with `reset(index)` and `capture(index, depth, segmentation)`, which writes the
image of one scene into two arrays `[H, W]`.
"""

import tempfile
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from modpush import Trainer
from modpush.envs import AnalyticDepthCamera, PushEnv, SceneView
from modpush.training import TRAIN_PRESETS


class NoisyDepthCamera(AnalyticDepthCamera):
    """Depth with Gaussian noise of 2 mm per metre of distance."""

    def __init__(self, scenes: SceneView, arm_in_depth: bool) -> None:
        super().__init__(scenes, arm_in_depth)
        self.rng = np.random.default_rng(0)

    def capture(
        self, index: int, depth: NDArray[np.float32], segmentation: NDArray[np.uint8]
    ) -> None:
        """Write the present image of scene `index` into `[H, W]` arrays: depth [m] and labels."""
        super().capture(index, depth, segmentation)
        depth += (0.002 * depth * self.rng.standard_normal(depth.shape)).astype(np.float32)
        np.clip(depth, 0.0, 1.1, out=depth)


def main(folder: Path) -> float:
    """Train a few steps with the camera; returns the noise in an image of it [m]."""
    Trainer(TRAIN_PRESETS["smoke"], folder, parts={"depth": NoisyDepthCamera}).run()
    exact, noisy = PushEnv(1, seed=0), PushEnv(1, seed=0, depth=NoisyDepthCamera)
    difference = exact.reset()["depth"] - noisy.reset()["depth"]
    exact.close()
    noisy.close()
    return float(difference.abs().mean())


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as folder:
        print(main(Path(folder) / "run"))
