"""Push with an exported agent: its policy runs in onnxruntime alone, the environment here is modpush's.

    modpush export small_cube --out runs/exported
    python examples/deploy.py runs/exported

The environment, which is TorchRL's, plans the sub-goals and cuts the window around the object. The
policy is one graph, from window and state to the command of the arm; it takes and returns numpy
arrays, and its `card.json` says which.
"""

import argparse
import json
import warnings
from pathlib import Path

import numpy as np
import onnxruntime
import torch
from torchrl.envs import Compose, EnvBase, InitTracker, TransformedEnv
from torchrl.envs.utils import step_mdp

from modpush.encoders import EgocentricWindow
from modpush.envs import PushEnv
from modpush.planners import OccupancyGrid, PlannerSubgoals


class OnnxPolicy:
    """`{name: array} -> command`, for the graph and the card in a folder."""

    def __init__(self, folder: Path) -> None:
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = 1
        self.session = onnxruntime.InferenceSession(folder / "window_policy.onnx", options)
        self.card = json.loads((folder / "card.json").read_text(encoding="utf-8"))
        self.names = [entry.name for entry in self.session.get_inputs()]

    def __call__(self, state: dict[str, np.ndarray]) -> np.ndarray:
        """The commands (dx, dy, dyaw) in [-1, 1] in the robot's base frame, `[B, 3]`."""
        _, command = self.session.run(None, {name: state[name] for name in self.names})
        return command


def make_env(card: dict, num_envs: int, scene: str) -> EnvBase:
    """`PushEnv` with what a robot has beside the policy: planner, sub-goals, window."""
    planning, window = card["planning"], card["window"]
    grid = OccupancyGrid(
        **planning["occupancy"],
        object_radius_key="object_radius",
        inscribed_radius_key="object_inscribed_radius",
    )
    transforms = Compose(
        InitTracker(),
        grid,
        PlannerSubgoals(**planning["subgoals"]),
        EgocentricWindow(
            window["frame"],
            size=window["size"],
            outside=window["outside"],
            metres_per_pixel=window["metres_per_pixel"],
        ),
    )
    pushed = card["environment"]["scenario"]["pushed_object"]
    env = PushEnv(num_envs, scene=scene, pushed_object=pushed, seed=0)
    return TransformedEnv(env, transforms)


def main(folder: Path, scene: str = "slot", num_envs: int = 4, steps: int = 200) -> float:
    """Run an episode in each scene; returns the share that succeeds."""
    policy = OnnxPolicy(folder)
    env = make_env(policy.card, num_envs, scene)
    state = env.reset()
    solved = np.zeros(num_envs, dtype=bool)
    for _ in range(steps):
        command = policy({name: state[name].numpy() for name in policy.names})
        # What has arrived rests.
        command[solved] = 0.0
        stepped = env.step(state.set("action", torch.from_numpy(command)))
        solved |= stepped["next", "success"].numpy()[:, 0]
        state = step_mdp(stepped)
        if solved.all():
            break
    env.close()
    print(f"{solved.sum()} of {num_envs} episodes solved in {scene!r}")
    return float(solved.mean())


if __name__ == "__main__":
    warnings.filterwarnings("ignore", message="Failed to find system libvulkan")
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("folder", type=Path, help="what `modpush export` wrote")
    parser.add_argument("--scene", default="slot", help="scene family")
    given = parser.parse_args()
    main(given.folder, given.scene)
