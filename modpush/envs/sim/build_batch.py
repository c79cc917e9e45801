"""Building the scenes of a `PushEnv` for a device."""

from typing import Any

import torch

from modpush.envs.depth.cameras import find_depth_camera
from modpush.envs.scenes.scenario import ScenarioConfig
from modpush.envs.sim.batch import SceneBatch
from modpush.envs.sim.cpu_batch import CpuBatch
from modpush.envs.sim.cuda_batch import CudaBatch
from modpush.envs.sim.rendering import choose_render_backend
from modpush.envs.simulation_config import SimulationConfig

__all__ = ["build_batch"]


def build_batch(
    num_envs: int,
    device: torch.device,
    scenario: ScenarioConfig,
    simulation: SimulationConfig,
    *,
    pictures: bool,
) -> SceneBatch:
    """Build scenes on a CPU or on CUDA, with a renderer only if it is needed.

    Args:
        num_envs: Number of scenes.
        device: Where they are simulated.
        scenario: Its objects are built.
        simulation: Tool, camera and rates.
        pictures: Whether `render` will be called.

    Raises:
        ValueError: If there is no such depth camera; the known ones are listed.
        RuntimeError: If a renderer or a CUDA device is needed and there is none.
    """
    depth = simulation.depth
    camera = None if depth is None else find_depth_camera(depth)
    task: dict[str, Any] = {
        "scenario": scenario,
        "robot_uids": f"ur5_{simulation.tool}",
        "dynamic_obstacles": simulation.dynamic_obstacles,
        "sim_freq": simulation.sim_freq,
        "control_freq": simulation.control_freq,
    }
    rendering = pictures or getattr(camera, "needs_renderer", False)
    task["render_backend"] = choose_render_backend() if rendering else "none"
    batch = CudaBatch if device.type == "cuda" else CpuBatch
    return batch(num_envs, camera, simulation.arm_in_depth, **task)
