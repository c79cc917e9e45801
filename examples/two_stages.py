"""Two agents one after the other: past obstacles to a position, then to a pose.

    python examples/two_stages.py                                  # five episodes of each set
    python examples/two_stages.py --episodes 100 --degrees 10      # as in docs/results/poses.md

The shipped agent for all objects pushes the box past obstacles, towards the goal's position. Once the
straight way to the goal is free and shorter than 15 cm, an agent that was trained in free space pushes it
to the goal's pose; beyond 25 cm the first one takes over again. Neither was trained for these scenes. One
environment emits what both observe, and the policy gives each agent the columns that it knows.
`examples/agents/pose_free.safetensors` is the agent of `modpush train pose`, seed 0.
"""

import argparse
import math
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import pandas as pd
import torch
from tensordict import TensorDict, TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor
from torchrl.envs import EnvBase

from modpush import load_agent, make_push_env
from modpush.envs import EpisodeConditions
from modpush.envs.scenes.shape_layouts import SHAPE_SCENES
from modpush.evaluation import evaluate, format_table, load_set, summarize
from modpush.mdp import PushObservation, recovering
from modpush.recipes import Agent

SCENES = (*SHAPE_SCENES,)
POSE_AGENT = Path(__file__).parent / "agents" / "pose_free.safetensors"
NEAR, FAR = 0.15, 0.25  # from the goal [m]
FREE = 0.005  # by how much longer than the straight way a path may be that is free [m]


def make_env(
    far: Agent, near: Agent, num_envs: int, objects: Sequence[str], conditions: EpisodeConditions
) -> EnvBase:
    """The environment of `near`, with the entries that only `far` observes at the end."""
    known = near.config.entries
    return make_push_env(
        near.config,
        num_envs=num_envs,
        add=tuple(name for name in entry_names(far) if name not in known),
        pushed_object=tuple(objects),
        **conditions.agent_options(near.config.inflation),
    )


def entry_names(agent: Agent) -> tuple[str, ...]:
    return (*agent.config.entries, *agent.config.add)


class TwoStages(TensorDictModuleBase):
    """A policy that gives the object from one agent to another, and back.

    Which of the two acts is kept in the tensordict, under `near_goal`, so that the policy has no state.
    """

    in_keys = ("observation", "path_length", "pose_error", "is_init")
    out_keys = ("action", ("next", "near_goal"))

    def __init__(self, far: Agent, near: Agent, columns: dict[str, slice]) -> None:
        super().__init__()
        self.far, self.near = far.actor, near.actor
        self.far_columns, self.near_columns = (
            torch.cat([torch.arange(columns[name].start, columns[name].stop) for name in names])
            for names in map(entry_names, (far, near))
        )

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Write the action, and which agent it is of."""
        distance = tensordict["pose_error"][..., :1]
        before = tensordict.get("near_goal", torch.zeros_like(tensordict["is_init"]))
        before = before & ~tensordict["is_init"]
        near = is_near(before, distance, tensordict["path_length"])
        observation = tensordict["observation"]
        action = torch.where(
            near,
            act(self.near, observation[..., self.near_columns]),
            act(self.far, observation[..., self.far_columns]),
        )
        tensordict["next", "near_goal"] = near
        return tensordict.set("action", action)


def is_near(before: Tensor, distance: Tensor, path_length: Tensor) -> Tensor:
    """Whether the second agent acts, `[..., 1]` bool.

    Args:
        before: Whether it acted in the step before, `[..., 1]` bool.
        distance: Distance from object to goal, `[..., 1]` [m].
        path_length: Length of the planned path, `[..., 1]` [m].
    """
    arrives = (distance < NEAR) & (path_length < distance + FREE)
    return torch.where(before, distance < FAR, arrives)


def act(actor: TensorDictModuleBase, observation: Tensor) -> Tensor:
    td = TensorDict({"observation": observation}, batch_size=observation.shape[:-1])
    return actor(td)["action"]


def main(episodes: int, degrees: float, out: Path, scenes: Sequence[str] = SCENES) -> pd.DataFrame:
    """Run the two agents on the sets, and print a line for each."""
    far, near = load_agent("any_object"), load_agent(POSE_AGENT)
    env = make_env(far, near, 1, ["box"], EpisodeConditions(goal="pose"))
    env.reset()
    columns = next(part for part in env.transform if isinstance(part, PushObservation)).columns
    env.close()
    policy = recovering(TwoStages(far, near, columns))
    summaries = []
    for scene in scenes:
        base = load_set(f"pose/{scene}/box").first(episodes)
        conditions = replace(base.conditions, yaw_tolerance=math.radians(degrees))
        name = f"{base.name}/{degrees:g}deg"
        rows = evaluate(
            policy,
            replace(base, name=name, conditions=conditions),
            out / name,
            make_env=partial(make_env, far, near),
        )
        summaries.append(summarize({name: rows}))
    shown = ["episodes", "success", "success_without_contact", "spl", "steps"]
    table = pd.concat(summaries)[shown]
    print(format_table(table))
    return table


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--episodes", type=int, default=5, help="of each set")
    parser.add_argument("--degrees", type=float, default=30.0, help="tolerance of the yaw")
    parser.add_argument("--out", type=Path, default=Path("runs/two_stages"))
    main(**vars(parser.parse_args()))
