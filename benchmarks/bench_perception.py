"""Times perception on rendered, noisy images of a pushed object, in milliseconds per image on one core.

    python benchmarks/bench_perception.py [--images 60] [--clock wall|cpu]

A camera of 640 x 480 pixels, inclined by 30 degrees, sees the arm push each object past a bar. `--clock
cpu` counts this process's own time, for machines that others work on.
"""

import argparse
import time

import cv2
import numpy as np

from modpush.deploy import Perception
from modpush.envs.depth.stereo_noise import stereo_noise
from modpush.envs.engines.mujoco.rendering import DepthRenderer
from modpush.envs.push_env import PushEnv
from modpush.envs.scenes.objects import PAPER_OBJECTS
from modpush.geometry import CameraModel

CAMERA = CameraModel.looking_at((0.5, 0.0, 0.0), (0.933, 0.25, 0.866))


def recorded(name: str, images: int) -> list[tuple[np.ndarray, np.ndarray]]:
    """Images and joint angles of episodes in which the tool moves at random, towards the object."""
    import torch

    env = PushEnv(1, scene="bar_across", pushed_object=name, engine="mujoco", seed=0, depth=None)
    rng, renderer, found = np.random.default_rng(0), DepthRenderer(CAMERA), []
    state = env.reset()
    (engine,) = env._batch.engines
    while len(found) < images:
        joints = state["joint_position"][0].numpy()
        found.append((stereo_noise(renderer(engine), rng), joints))
        way = (state["object_pose"] - state["ee_pose"])[0, :2].numpy()
        step = np.array([*(way / np.linalg.norm(way)), 0.0]) + rng.normal(0, 0.3, 3)
        action = torch.from_numpy(np.clip(step, -1, 1)[None].astype(np.float32))
        state = env.step(state.set("action", action))["next"]
    env.close()
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--images", type=int, default=60)
    parser.add_argument("--clock", choices=("wall", "cpu"), default="wall")
    args = parser.parse_args()
    clock = time.perf_counter if args.clock == "wall" else time.thread_time
    cv2.setNumThreads(1)
    print(f"{'object':16} {'first':>7} {'median':>7} {'95 %':>7}  ms per image")
    for name in PAPER_OBJECTS:
        images, perception = recorded(name, args.images), Perception(CAMERA, name)
        perception.update(*images[0])  # compiles, or loads what was compiled
        perception.reset()
        times = []
        for depth, joints in images:
            start = clock()
            perception.update(depth, joints)
            times.append(1e3 * (clock() - start))
        first, *rest = times
        print(f"{name:16} {first:7.1f} {np.median(rest):7.1f} {np.percentile(rest, 95):7.1f}")


if __name__ == "__main__":
    main()
