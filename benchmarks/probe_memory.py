"""How well hidden properties can be read from an agent's memory: a linear probe.

python benchmarks/probe_memory.py --policy examples/agents/any_object_memory.safetensors

The agent runs on the cells of `tuning/hidden_dynamics` and on the first of `hidden_dynamics`, which
have other starts. In each step after eight remembered ones, a ridge regression predicts what is hidden,
in the agent's frame: it is fitted on the first cells, and its share of explained variance (R2) is
measured on the second, 0 for the mean of those. It reads the entry `history`, the network's first and
second hidden layer, and these with the history set to zero: what they know without it.
"""

import argparse
from typing import Any

import torch
from torch import Tensor
from torchrl.envs.utils import ExplorationType, set_exploration_type, step_mdp

from modpush.evaluation import EvaluationSet, load_set
from modpush.mdp import PushObservation
from modpush.recipes import Agent, load_agent

SCENES = 20
EVERY = 3  # steps between samples
RIDGE = 1e-2  # of the variance of each input
TARGETS = ("mass", "friction", "centre, x", "centre, y")


def main() -> None:
    """Print a table in Markdown."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--policy", required=True)
    parser.add_argument("--episodes", type=int, default=200)
    args = parser.parse_args()
    agent = load_agent(args.policy)
    names = ("tuning/hidden_dynamics", "hidden_dynamics")
    fitted, held_out = (record(agent, load_set(name).first(args.episodes)) for name in names)
    print(f"{len(fitted['target'])} and {len(held_out['target'])} steps\n")
    print(f"| read from | {' | '.join(TARGETS)} |\n|{'---|' * (1 + len(TARGETS))}")
    for name in fitted:
        if name != "target":
            shares = explained(fitted[name], fitted["target"], held_out[name], held_out["target"])
            print(f"| {name} | {' | '.join(f'{share:.2f}' for share in shares.tolist())} |")


def record(agent: Agent, cells: EvaluationSet) -> dict[str, Tensor]:
    """Inputs of the probe and its targets, `[N, n]` each, of steps with a full history."""
    options = cells.conditions.agent_options(agent.config.inflation)
    env = agent.make_env(SCENES, object_dynamics=True, **options)
    transforms: Any = env.transform
    columns = next(t for t in transforms if type(t) is PushObservation).columns["history"]
    target = PushObservation(agent.config.frame, entries=["object_dynamics"])
    rows: list[dict[str, Tensor]] = []
    with torch.no_grad(), set_exploration_type(ExplorationType.DETERMINISTIC):
        for first in range(0, len(cells) - SCENES + 1, SCENES):
            td = env.reset(scenarios=list(cells.scenarios[first : first + SCENES]))
            active = torch.ones(SCENES, dtype=torch.bool)
            for step in range(cells.conditions.max_episode_steps):
                full = td["history"][:, -1].any(-1) & active
                if step % EVERY == 0 and full.any():
                    rows.append(sample(agent, td[full], columns, target))
                td = env.step(agent.policy(td))
                active &= ~td["next", "done"][:, 0]
                if not active.any():
                    break
                td = step_mdp(td)
    env.close()
    return {name: torch.cat([row[name] for row in rows]) for name in rows[0]}


def sample(agent: Agent, td: Any, columns: slice, target: PushObservation) -> dict[str, Tensor]:
    """Inputs of the probe and its targets in some scenes."""
    observation = td["observation"]
    blank = observation.clone()
    blank[:, columns] = 0.0
    actor: Any = agent.actor
    layers = list(actor.module[0].module[0])
    first, second = torch.nn.Sequential(*layers[:2]), torch.nn.Sequential(*layers[:4])
    return {
        "`history`": observation[:, columns],
        "first layer": first(observation),
        "first layer, history zero": first(blank),
        "second layer": second(observation),
        "second layer, history zero": second(blank),
        "target": target(td.clone())["observation"],
    }


def explained(x: Tensor, y: Tensor, x_new: Tensor, y_new: Tensor) -> Tensor:
    """Share of the variance of each target that a ridge regression explains on new rows."""
    x, y, x_new, y_new = (value.double() for value in (x, y, x_new, y_new))
    mean, scale = x.mean(0), x.std(0).clamp_min(1e-6)
    x, x_new, offset = (x - mean) / scale, (x_new - mean) / scale, y.mean(0)
    gram = x.T @ x / len(x) + RIDGE * torch.eye(x.shape[1], dtype=x.dtype)
    weights = torch.linalg.solve(gram, x.T @ (y - offset) / len(x))
    residual = y_new - (x_new @ weights + offset)
    return 1 - residual.square().mean(0) / (y_new - y_new.mean(0)).square().mean(0)


if __name__ == "__main__":
    main()
