"""One agent whose weights are the mean of several: of a run's checkpoints, or of agents' files.

    python examples/average_agents.py runs/pose_obstacles --steps 275072 300032 --out mean.safetensors
    python examples/average_agents.py a.safetensors b.safetensors --out mean.safetensors
    python examples/average_agents.py a.safetensors --set planner_margin 0.0 --out changed.safetensors

Late policies of one run lie near each other, and their mean may be better than each of them. A run keeps
its two newest checkpoints unless `--train.keep-checkpoints` says otherwise. `--set` changes fields of the
agent's config, such as those of its planner.
"""

import argparse
import ast
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from modpush import load_agent
from modpush.recipes import Agent, save_agent
from modpush.training.run_folder import RunFolder, read_checkpoint

_OF_AVERAGE = "module."
"""Prefix of the weights in the moving average of a checkpoint."""


def weights_at(run: Path, steps: int) -> dict[str, Tensor]:
    """The weights of the actor that a run's checkpoint evaluates and saves."""
    state = read_checkpoint(run / "checkpoints" / f"step-{steps:09d}.safetensors")["average"]
    if state is None:
        raise ValueError(f"average_agents: {run} must have actor_average > 0, got no average.")
    return {
        name.removeprefix(_OF_AVERAGE): value
        for name, value in state.items()
        if name.startswith(_OF_AVERAGE)
    }


def mean(states: Sequence[Mapping[str, Tensor]]) -> dict[str, Tensor]:
    """The mean of several `state_dict`s of one architecture."""
    return {
        name: torch.stack([state[name].double() for state in states]).mean(0).to(value.dtype)
        for name, value in states[0].items()
    }


def hidden_sizes(agent: Agent) -> tuple[int, ...]:
    """Widths of the hidden layers of an agent's network."""
    return tuple(len(p) for p in agent.actor.parameters() if p.ndim == 2)[:-1]


def main(agents: Sequence[Path], out: Path, steps: Sequence[int], changes: Sequence[Any]) -> None:
    """Write the mean."""
    run = agents[0]
    agent = load_agent(RunFolder(run).last_agent if steps else run)
    states = [weights_at(run, n) for n in steps]
    states = states or [load_agent(path).actor.state_dict() for path in agents]
    actor = agent.actor.requires_grad_(False)
    actor.load_state_dict(mean(states))
    sources: list[Any] = [*steps] or [str(path) for path in agents]
    fields = {name: ast.literal_eval(value) for name, value in changes}
    save_agent(
        out,
        actor,
        agent.config.with_fields(**fields),
        hidden_sizes=hidden_sizes(agent),
        observation_dim=next(actor.parameters()).shape[1],
        fingerprint=agent.fingerprint,
        metadata={**agent.metadata, **({"mean_of": sources} if len(states) > 1 else {})},
    )
    print(f"{out}: the mean of {len(states)}")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("agents", type=Path, nargs="+", help="a run's folder, or agents' files")
    parser.add_argument("--steps", type=int, nargs="+", default=[], help="checkpoints of the run")
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument(
        "--set", nargs=2, action="append", default=[], dest="changes", metavar=("FIELD", "VALUE")
    )
    main(**vars(parser.parse_args()))
