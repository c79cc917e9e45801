"""An episode depends on its start and its actions only, a continuation on its state, to the last bit."""

from collections.abc import Sequence
from dataclasses import replace
from itertools import cycle, islice, product

import numpy as np
import pytest
import torch
from sapien import physx
from tensordict import TensorDictBase

from modpush.envs import OBJECTS, SCENES, PushEnv, Scenario, ScenarioConfig, sample_scenario

KEYS = ("object_pose", "ee_pose", "joint_position", "object_contact", "obstacle_contact")
COUNTS = [pytest.param(1, id="quick"), pytest.param(29, id="slow", marks=pytest.mark.slow)]


def make_env(num_envs: int = 1) -> PushEnv:
    return PushEnv(
        num_envs,
        scene=list(SCENES),
        pushed_object=list(OBJECTS),
        depth=None,
        max_episode_steps=None,
    )


def draw(count: int) -> list[Scenario]:
    """`count` scenarios for every object in every family, as far as all of them can be pushed in all.

    With 1 one for every family, the objects in turn.
    """
    pairs = zip(cycle(OBJECTS), SCENES) if count == 1 else product(OBJECTS, SCENES)
    rng, distance = np.random.default_rng(0), (0.2, 0.35)
    return [
        sample_scenario(
            rng,
            ScenarioConfig(scene=scene, pushed_object=item, distance=distance),
            tool="2f85",
        )
        for item, scene in pairs
        for _ in range(count)
    ]


def push(env: PushEnv, td: TensorDictBase, seeds: Sequence[int], steps: int = 25) -> np.ndarray:
    """Push at the object, with noise of these seeds; what was seen, `[B, steps, 14]`."""
    rngs, seen = [np.random.default_rng(seed) for seed in seeds], []
    for _ in range(steps):
        way = (td["object_pose"] - td["ee_pose"])[:, :2].double().numpy()
        way = 0.9 * way / np.maximum(np.linalg.norm(way, axis=1, keepdims=True), 1e-3)
        noise = np.stack([rng.normal(0, (0.4, 0.4, 0.5)) for rng in rngs])
        action = np.clip(np.pad(way, ((0, 0), (0, 1))) + noise, -1, 1)
        td = env.step(td.set("action", torch.from_numpy(action.astype(np.float32))))["next"]
        seen.append(torch.cat([td[key].float() for key in KEYS], -1).numpy())
    return np.stack(seen, 1)


@pytest.mark.parametrize("count", COUNTS)
def test_an_episode_depends_neither_on_those_before_nor_on_num_envs(count) -> None:
    scenarios, env, batch = draw(count), make_env(), make_env(4)
    n = len(scenarios)
    first = [push(env, env.reset(scenarios=[s]), [k])[0] for k, s in enumerate(scenarios)]
    for k in np.random.default_rng(1).permutation(n):
        again = push(env, env.reset(scenarios=[scenarios[k]]), [k])[0]
        np.testing.assert_array_equal(again, first[k], err_msg=str(scenarios[k]))
    for rows in np.random.default_rng(2).permutation(n).reshape(-1, 4):
        seen = push(batch, batch.reset(scenarios=[scenarios[k] for k in rows]), rows)
        np.testing.assert_array_equal(seen, [first[k] for k in rows], err_msg=str(rows))
    env.close()
    batch.close()


def test_an_episode_does_not_depend_on_the_centre_of_mass_of_the_one_before() -> None:
    env, scenarios = make_env(), draw(1)
    first = [push(env, env.reset(scenarios=[s]), [k], 3)[0] for k, s in enumerate(scenarios)]
    for k, scenario in enumerate(scenarios):
        dynamics = replace(scenario.dynamics, center_of_mass=(0.003, -0.002))
        env.reset(scenarios=[replace(scenario, dynamics=dynamics)])
        again = push(env, env.reset(scenarios=[scenario]), [k], 3)[0]
        np.testing.assert_array_equal(again, first[k], err_msg=str(scenario))
    env.close()


@pytest.mark.parametrize("count", COUNTS)
def test_continuations_of_one_state_are_equal_in_this_and_another_environment(count) -> None:
    env, other = make_env(), make_env(2)
    other.reset()
    touched = 0
    for k, scenario in enumerate(draw(count)):
        touched += push(env, env.reset(scenarios=[scenario]), [k], 15)[0, -1, 12:].any()
        state = env.get_state()
        first = push(env, env.set_state(state), [k])[0]
        if k % 2:
            push(env, env.reset(), [k], 3)
        np.testing.assert_array_equal(
            push(env, env.set_state(state), [k])[0], first, err_msg=str(scenario)
        )
        there = push(other, other.set_state(state, [k % 2]), [k, k])[k % 2]
        np.testing.assert_array_equal(there, first, err_msg=str(scenario))
    assert touched > 0.3 * len(draw(count))  # in the midst of pushing
    env.close()
    other.close()


def test_the_time_that_an_object_has_been_slow_does_not_count_on() -> None:
    """PhysX counts how long a body has been almost at rest; in this one of 100 scenarios it told."""
    rng, config = np.random.default_rng(0), ScenarioConfig(pushed_object="small_cube")
    for scene in islice(cycle(SCENES), 26):
        scenario = sample_scenario(rng, replace(config, scene=scene), tool="2f85")
    env = make_env()
    push(env, env.reset(scenarios=[scenario]), [25], 20)
    state = env.get_state()
    first, again = (push(env, env.set_state(state), [225], 30) for _ in range(2))
    np.testing.assert_array_equal(again, first)
    env.close()


def test_settings_of_another_environment_in_the_process_change_nothing() -> None:
    env, scenarios = make_env(), draw(1)
    first = [push(env, env.reset(scenarios=[s]), [0]) for s in scenarios]
    before = physx.get_shape_config().contact_offset
    try:
        physx.set_shape_config(contact_offset=0.03)
        physx.set_scene_config(gravity=np.array([0, 0, -1.0]))
        again = [push(env, env.reset(scenarios=[s]), [0]) for s in scenarios]
    finally:
        physx.set_shape_config(contact_offset=before)
        physx.set_scene_config(gravity=np.array([0, 0, -9.81]))
    np.testing.assert_array_equal(again, first)
    env.close()
