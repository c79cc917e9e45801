"""Obstacles that move by themselves in `PushEnv`: image, map, path, states and keys."""

import json
import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
import torch
from torchrl.envs import TransformedEnv
from torchrl.envs.utils import check_env_specs

from modpush.envs import ClutterPushEnv, Obstacle, Patrol, PushEnv, PushState, Scenario
from modpush.envs.engines.recorded import RecordedEngine, Recording
from modpush.mdp import PushObservation
from modpush.planners import OccupancyGrid, PlannerSubgoals
from tests.envs.engines.sapien.test_agent import scenario

ACROSS = math.pi / 2
PATROL = Patrol(velocity=(0.0, 0.1), ahead=0.20, behind=0.20)
BAR = Obstacle((0.20, 0.06, 0.06), (0.475, 0.0, ACROSS), PATROL)
CUBE = Obstacle((0.05, 0.05, 0.05), (0.65, -0.30, 0.0))
ASIDE = (0.25, -0.30, 0.0)
START = scenario(ASIDE, (0.35, 0.0, 0.0), goal_position=(0.60, 0.0), obstacles=(CUBE, BAR))
STILL = torch.zeros(1, 3)


def standing(time: float) -> Scenario:
    return replace(START, obstacles=tuple(o.standing(time) for o in START.obstacles))


def stepped(env, count: int):
    td = env.reset(scenarios=[START])
    for _ in range(count):
        td = env.step(td.set("action", STILL))["next"]
    return td


@pytest.fixture(scope="module", params=["sapien", "mujoco"])
def env(request) -> Iterator[PushEnv]:
    env = PushEnv(1, engine=request.param, obstacle_motion=True, seed=0)
    yield env
    env.close()


def test_the_image_shows_an_obstacle_where_it_is_at_each_step(env) -> None:
    for count in (1, 15, 45):  # the last one on its way back
        seen = stepped(env, count)
        fresh = env.reset(scenarios=[standing(count / 15)])
        assert torch.equal(seen["segmentation"] == 2, fresh["segmentation"] == 2)
        # What is not touched settles on the table by micrometres.
        torch.testing.assert_close(seen["depth"], fresh["depth"], atol=1e-5, rtol=0.0)


def test_the_path_is_planned_around_an_obstacle_where_it_is_now(env) -> None:
    planning = TransformedEnv(
        env, OccupancyGrid(object_radius_key="object_radius")
    ).append_transform(PlannerSubgoals("lazy_theta_star"))
    try:
        blocked = planning.reset(scenarios=[START])["path_length"].item()
        lengths = [stepped(planning, count)["path_length"].item() for count in (15, 30)]
        expected = [
            planning.reset(scenarios=[standing(time)])["path_length"].item() for time in (1, 2)
        ]
    finally:
        planning.empty_cache()
    assert blocked > 0.26
    assert lengths == pytest.approx(expected, abs=2e-3)
    assert lengths[1] == pytest.approx(0.25, abs=2e-3)  # straight: the bar has moved out of the way


def test_a_state_in_mid_patrol_continues_to_the_last_bit(env) -> None:
    td = stepped(env, 37)
    state = PushState.from_dict(json.loads(json.dumps(env.get_state().to_dict())))
    assert state.scenes[0].steps == 37
    ends = []
    for _ in range(2):
        again = env.reset(state=state)
        torch.testing.assert_close(again["depth"], td["depth"], atol=1e-6, rtol=0.0)
        for _ in range(20):
            again = env.step(again.set("action", STILL))["next"]
        ends.append(again)
        env.reset()
    for key in ("object_pose", "depth", "obstacle_motion"):
        assert torch.equal(ends[0][key], ends[1][key])
    torch.testing.assert_close(ends[0]["depth"], stepped(env, 57)["depth"], atol=1e-5, rtol=0.0)


def test_a_state_of_before_there_were_motions_is_read(env) -> None:
    env.reset(scenarios=[standing(0.0)])
    plain = env.get_state().to_dict()
    del plain["scenes"][0]["steps"]
    assert PushState.from_dict(plain).scenes[0].steps == 0


def test_the_motion_of_the_nearest_moving_obstacle_is_emitted(env) -> None:
    check_env_specs(env)
    assert stepped(env, 45)["obstacle_motion"][0].tolist() == pytest.approx([0.475, 0.1, 0.0, -0.1])
    far = Obstacle(
        CUBE.size, (0.70, 0.30, 0.0), Patrol(velocity=(-0.2, 0.0), ahead=0.1, behind=0.0)
    )
    start = replace(START, obstacles=(far, BAR))
    assert env.reset(scenarios=[start])["obstacle_motion"][0].tolist() == pytest.approx(
        [0.475, 0.0, 0.0, 0.1]
    )
    near_far = replace(start, object_pose=(0.70, 0.20, 0.0))
    assert env.reset(scenarios=[near_far])["obstacle_motion"][0].tolist() == pytest.approx(
        [0.70, 0.30, -0.2, 0.0]
    )
    assert not env.reset(scenarios=[standing(0.0)])["obstacle_motion"].any()


def test_the_entry_is_in_the_agents_frame_and_zero_without_a_moving_obstacle(env) -> None:
    observe = PushObservation("base", entries=["obstacle_motion"], raw=True)
    td = observe(stepped(env, 15))
    assert td["observation"][0].tolist() == pytest.approx([0.125, 0.1, 0.0, 0.1], abs=1e-4)
    td = stepped(env, 15)
    turned = td.set("object_pose", td["object_pose"] + torch.tensor([0.0, 0.0, ACROSS]))
    own = PushObservation("object", entries=["obstacle_motion"], raw=True)(turned)
    assert own["observation"][0].tolist() == pytest.approx([0.1, -0.125, 0.1, 0.0], abs=1e-3)
    td = observe(env.reset(scenarios=[standing(0.0)]))
    assert td["observation"].tolist() == [[0.0] * 4]


def test_an_episode_that_is_played_again_shows_the_obstacles_of_its_time(env) -> None:
    steps = [env.reset(scenarios=[START])]
    for _ in range(20):
        steps.append(env.step(steps[-1].clone().set("action", STILL))["next"])
    keys = "object_pose", "ee_pose", "joint_position"
    course = {key: torch.cat([td[key] for td in steps]).numpy() for key in keys}
    made: list[RecordedEngine] = []

    def recorded(spec) -> RecordedEngine:
        made.append(RecordedEngine(spec))
        return made[-1]

    again = PushEnv(1, obstacle_motion=True, engine=recorded, sim_freq=15)
    made[0].recording = Recording(contacts=np.zeros((20, 6), bool), **course)
    td = again.reset(scenarios=[START])
    for _ in range(20):
        td = again.step(td.set("action", STILL))["next"]
    assert torch.equal(td["obstacle_motion"], steps[-1]["obstacle_motion"])
    torch.testing.assert_close(td["depth"], steps[-1]["depth"], atol=1e-5, rtol=0.0)
    again.close()


def test_the_task_of_maniskill_refuses_moving_obstacles() -> None:
    task = ClutterPushEnv(obs_mode="none")
    with pytest.raises(ValueError, match="obstacles must have motion=None here and on CUDA"):
        task.reset(options={"scenarios": [START]})
    task.close()


def test_an_episode_in_which_an_obstacle_pushes_the_object_is_a_collision() -> None:
    env = PushEnv(1, depth=None)
    start = replace(START, object_pose=(0.475, 0.17, 0.0), goal_position=(0.3, 0.3))
    td = env.reset(scenarios=[start])
    touched = []
    for _ in range(30):
        td = env.step(td.set("action", STILL))["next"]
        touched.append(bool(td["obstacle_contact"]))
    assert not any(touched[:5])
    assert all(touched[-5:])
    assert td["object_pose"][0, 1] == pytest.approx(0.2 + 0.1 + 0.025, abs=2e-3)
    env.close()
