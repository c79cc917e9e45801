"""A planner of your own: along the table's axes, first out from the robot and then sideways.

    python examples/extending/planner.py

Contract: `plan(occupancy [B, H, W] bool, start [B, 2], goal [B, 2]) -> Paths` in pixels (u, v). This one
ignores obstacles; a real one returns None for scenes without a path.
"""

import tempfile
from pathlib import Path

import torch
from torch import Tensor

from modpush import Trainer, load_agent
from modpush.planners import Paths, Planner
from modpush.training import TRAIN_PRESETS


class AlongTheAxes(Planner):
    """Paths of two legs, each along an axis of the table."""

    def plan(self, occupancy: Tensor, start: Tensor, goal: Tensor) -> Paths:
        """Plan one path for each scene.

        Args:
            occupancy: Blocked cells, `[B, H, W]` bool.
            start: Where the paths begin, `[B, 2]` (u, v) [px].
            goal: Where they end, `[B, 2]` (u, v) [px].
        """
        corner = torch.stack([start[:, 0], goal[:, 1]], -1)
        paths = [torch.stack(points) for points in zip(start, corner, goal, strict=True)]
        return Paths.from_waypoints(paths, start)


def main(folder: Path) -> float:
    """Train a few steps along such paths; returns how much longer they are than the straight line."""
    parts = {"planner": AlongTheAxes()}
    Trainer(TRAIN_PRESETS["smoke"], folder, parts=parts).run()
    agent = load_agent(folder / "last_agent.safetensors", parts=parts)
    env = agent.make_env(num_envs=2, seed=0)
    td = env.reset()
    env.close()
    straight = (td["goal_position"] - td["object_pose"][:, :2]).norm(dim=-1)
    return float((td["path_length"][:, 0] / straight).max())


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as folder:
        print(main(Path(folder) / "run"))
