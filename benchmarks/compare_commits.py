"""What a step, a reset, a plan and an update of TQC cost in two checkouts of the project, in turns.

    git worktree add ../old 2cd1fa5
    python benchmarks/compare_commits.py ../old .

Each checkout runs in a process of its own, and the two take turns block by block, so that a machine whose
speed drifts slows both. Measured is processor time, which other processes change less than wall time.
Prints medians and, of the ratios of neighbouring blocks, the median and the quartiles.
"""

import os
import subprocess
import sys
from pathlib import Path
from typing import Annotated

import numpy as np
import tyro

WORKER = """
import sys, time, warnings
warnings.filterwarnings("ignore")
import numpy as np, torch
torch.set_num_threads(1)
from modpush.envs import PushEnv
from modpush.agents import TQCConfig, make_tqc
from modpush.planners import DistanceField, LazyThetaStar
from modpush.recipes import PushEnvConfig, make_push_env
from modpush.replay import ReplayConfig, make_replay_buffer

jobs = {}
for name, depth in ("step", None), ("step with depth", "analytic"):
    env = PushEnv(8, scene="free", depth=depth, seed=1, max_episode_steps=None)
    start, random = env.reset(), torch.Generator().manual_seed(0)
    def step(env=env, start=start, random=random):
        env.step(start.set("action", torch.rand(8, 3, generator=random) * 0.4 - 0.2))
    jobs[name] = step, 10
env = PushEnv(8, scene="free", depth=None, seed=1)
jobs["reset"] = env.reset, 3
random = np.random.default_rng(0)
for kind in DistanceField, LazyThetaStar:
    for batch in 1, 8:
        queries = []
        for _ in range(20):
            blocks = torch.from_numpy(random.random((batch, 16, 16)) < 0.2)
            ends = torch.from_numpy(random.uniform(0, 63, (2, batch, 2)).astype(np.float32))
            queries.append((blocks.repeat_interleave(4, 1).repeat_interleave(4, 2), *ends))
        def plan(planner=kind(), queries=queries):
            for query in queries:
                planner.plan(*query)
        jobs[f"20 plans of {kind.__name__}, {batch} at once"] = plan, 2
env = make_push_env(PushEnvConfig.preset("cpu", num_envs=8), seed=1)
transitions = env.rollout(300, break_when_any_done=False).reshape(-1)
for hidden, size in ((256, 256), 256), ((512, 256, 128), 512):
    agent = make_tqc(TQCConfig(hidden_sizes=hidden, batch_size=size), env)
    buffer = make_replay_buffer(ReplayConfig(capacity=10_000, batch_size=size))
    buffer.extend(transitions.select("observation", "action", "done", "terminated", "truncated",
        ("next", "observation"), ("next", "reward"), ("next", "done"), ("next", "terminated"),
        ("next", "truncated")))
    jobs[f"update, {'-'.join(map(str, hidden))}, batch {size}"] = (
        lambda agent=agent, buffer=buffer: agent.update(buffer.sample())), 3
for job, _ in jobs.values():
    for _ in range(20):
        job()
print("\\t".join(jobs), flush=True)
for line in sys.stdin:
    job, count = jobs[line.strip()]
    began = time.process_time_ns()
    for _ in range(count):
        job()
    print((time.process_time_ns() - began) / count / 1e6, flush=True)
"""


def start(checkout: Path) -> "subprocess.Popen[str]":
    """Start the process of a checkout."""
    return subprocess.Popen(
        [sys.executable, "-c", WORKER],
        cwd=checkout,
        env={
            **os.environ,
            "OMP_NUM_THREADS": "1",
            "RL_LOGGING_LEVEL": "ERROR",
            "PYTHONPATH": str(checkout.resolve()),
        },
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        encoding="utf-8",
    )


def measure(process: "subprocess.Popen[str]", job: str) -> float:
    """Mean processor time of a block of a job [ms]."""
    assert process.stdin is not None
    assert process.stdout is not None
    process.stdin.write(job + "\n")
    process.stdin.flush()
    return float(process.stdout.readline())


def main(
    old: Annotated[Path, tyro.conf.Positional],
    new: Annotated[Path, tyro.conf.Positional],
    blocks: int = 100,
) -> None:
    """Print the table.

    Args:
        old: Folder of the checkout to compare with.
        new: Folder of the other.
        blocks: Number of blocks of each.
    """
    first, second = start(old), start(new)
    assert first.stdout is not None
    assert second.stdout is not None
    jobs = first.stdout.readline().strip().split("\t")
    second.stdout.readline()
    print("| 8 scenes | old [ms] | new [ms] | new / old | quartiles |\n|---|---|---|---|---|")
    for job in jobs:
        times = np.empty((blocks, 2))
        for block in times:
            block[:] = measure(first, job), measure(second, job)
        low, ratio, high = np.quantile(times[:, 1] / times[:, 0], (0.25, 0.5, 0.75))
        before, after = np.median(times, axis=0)
        print(
            f"| {job} | {before:.2f} | {after:.2f} | {ratio:.3f} | {low:.3f} to {high:.3f} |",
            flush=True,
        )
    for process in (first, second):
        process.kill()


if __name__ == "__main__":
    tyro.cli(main, description=__doc__)
