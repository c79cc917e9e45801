"""Random actions for minutes: nothing breaks, sinks, tunnels, drifts or grows.

`MODPUSH_SOAK_MINUTES=10 pytest -m slow tests/envs/test_soak.py -s` prints the figures.
"""

import os
import time

import numpy as np
import psutil
import pytest
import torch

from modpush.envs import OBJECTS, SCENES, PushEnv
from modpush.envs.scenes.objects import get_object

NUM_ENVS = 8
SETTLED = 5  # steps without any contact after which the arm must be back at its height


def deepest(env: PushEnv) -> tuple[float, str]:
    """Deepest overlap of a pushed object with an obstacle or the table now [m], and where."""
    worst = (0.0, "")
    for scenario, engine in zip(env.scenarios, env._batch.engines, strict=True):
        gaps = engine.gaps()
        overlap = -min(gaps["object_obstacle"], gaps["object_table"])
        worst = max(worst, (overlap, f"{scenario.pushed_object} in {scenario.scene}"))
    return worst


@pytest.mark.slow
def test_soak() -> None:
    minutes = float(os.environ.get("MODPUSH_SOAK_MINUTES", "10"))
    env = PushEnv(NUM_ENVS, scene=tuple(SCENES), pushed_object=tuple(OBJECTS), seed=0)
    rng = np.random.default_rng(0)
    td, noise = env.reset(), np.zeros((NUM_ENVS, 3))
    calm = np.zeros(NUM_ENVS, dtype=int)
    depth, drift, lowest, steps, episodes = (0.0, ""), 0.0, 0.0, 0, NUM_ENVS
    families, memory = set(), []
    process, start = psutil.Process(), time.monotonic()
    while time.monotonic() - start < 60 * minutes:
        # Correlated noise travels; pulled to the object it touches things all the time.
        noise = 0.9 * noise + 0.5 * rng.normal(size=(NUM_ENVS, 3))
        pull = (td["object_pose"] - td["ee_pose"])[:, :2].numpy() * 8
        action = np.clip(noise + np.pad(pull, ((0, 0), (0, 1))), -1, 1)
        td = env.step(td.set("action", torch.from_numpy(action).float()))["next"]
        steps += NUM_ENVS
        for key in ("object_pose", "ee_pose", "joint_position", "depth"):
            assert td[key].isfinite().all(), key
        touching = (td["object_contact"] | td["tool_obstacle_contact"])[:, 0].numpy()
        calm = np.where(touching, 0, calm + 1)
        depth = max(depth, deepest(env))
        for i, scenario in enumerate(env.scenarios):
            item = get_object(scenario.pushed_object)
            height = env._batch.link_transforms_of(i, ("tip",))[0, 2]
            if calm[i] >= SETTLED:
                drift = max(drift, abs(height - item.tool_height))
            lowest = min(lowest, env._batch.object_transform_of(i)[2] - item.height / 2)
        if td["done"].any():
            families |= {env.scenarios[i].scene for i in torch.nonzero(td["done"])[:, 0].tolist()}
            episodes += int(td["done"].sum())
            calm[td["done"][:, 0].numpy()] = 0
            td = env.reset(td.clone().set("_reset", td["done"].clone()))
            memory.append(process.memory_info().rss)
    env.close()
    growth = (np.median(memory[-10:]) - np.median(memory[len(memory) // 4 :][:10])) / 2**20
    print(
        f"\nsoak: {minutes:g} min, {steps} scene-steps, {episodes} episodes, "
        f"{len(families)} families; deepest overlap {depth[0] * 1e3:.2f} mm ({depth[1]}), object sank "
        f"{-lowest * 1e3:.2f} mm, tool height off by {drift * 1e3:.2f} mm in free motion, "
        f"memory grew by {growth:.1f} MiB"
    )
    assert families == set(SCENES) or minutes < 5
    assert depth[0] <= 0.003
    assert lowest >= -0.003
    assert drift <= 0.002
    assert growth <= 10
