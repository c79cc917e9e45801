"""The scripted pusher in free space at both physics rates, from the same starts.

    python benchmarks/pusher_rates.py         # 100 episodes an object and rate, some 3 minutes

Contact is the fraction of control steps with contact from the first one on, mean over episodes.
"""

import warnings
from dataclasses import dataclass

import numpy as np
import torch
import tyro

from modpush.agents import ScriptedPusher
from modpush.envs import OBJECTS, PushEnv

NUM_ENVS = 10


@dataclass(frozen=True, kw_only=True)
class Config:
    """How much to run."""

    episodes: int = 100
    """An object and rate; a multiple of 10."""
    seed: int = 0
    """Of the starts."""


def run(name: str, sim_freq: int, config: Config) -> tuple[float, float]:
    """Success and contact rate of one object at one rate."""
    env = PushEnv(NUM_ENVS, pushed_object=name, sim_freq=sim_freq, depth=None, seed=config.seed)
    policy = ScriptedPusher()
    success, contact = [], []
    for _ in range(config.episodes // NUM_ENVS):
        td = env.reset()
        touched, ended = [], torch.zeros(NUM_ENVS, dtype=torch.bool)
        solved = torch.zeros(NUM_ENVS, dtype=torch.bool)
        while not ended.all():
            td = env.step(policy(td))["next"]
            # NaN after the episode's end, so that it does not count.
            touched.append(td["object_contact"][:, 0].double().masked_fill(ended, float("nan")))
            solved |= td["success"][:, 0] & ~ended
            ended |= td["done"][:, 0]
        success += solved.tolist()
        for row in torch.stack(touched, 1).numpy():
            first = int(np.argmax(row == 1))
            contact.append(float(np.nanmean(row[first:])) if (row == 1).any() else 0.0)
    env.close()
    return float(np.mean(success)), float(np.mean(contact))


def main(config: Config) -> None:
    """Run and print one table."""
    torch.set_num_threads(1)
    print("| object | success 120 Hz | 240 Hz | contact 120 Hz | 240 Hz |\n|---|---|---|---|---|")
    for name in OBJECTS:
        (s120, c120), (s240, c240) = (run(name, rate, config) for rate in (120, 240))
        print(f"| {name} | {s120:.2f} | {s240:.2f} | {c120:.3f} | {c240:.3f} |", flush=True)


if __name__ == "__main__":
    warnings.filterwarnings("ignore")
    main(tyro.cli(Config, description=__doc__))
