"""The paper's stack of transforms in one call."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
import torch
from torch import nn
from torchrl.envs import ParallelEnv, check_env_specs
from torchrl.envs.utils import step_mdp

from modpush.encoders import RayScan
from modpush.envs import ScenarioConfig
from modpush.envs.scenes.objects import OBJECTS, PushedObject
from modpush.envs.scenes.sampling import sample_scenario
from modpush.geometry import box
from modpush.mdp import PATH_AHEAD_ENTRIES, Curriculum, Entry, RewardConfig
from modpush.planners import OccupancyGrid, StraightLine
from modpush.recipes import PushEnvConfig, make_push_env
from modpush.recipes.fingerprint import environment_fingerprint
from tests.own_parts import MeanHeight, goal_direction

RAYS = PushEnvConfig.preset("cpu", num_envs=2, encoder="rays", scene=("posts",))


class Nothing(nn.Module):
    """An encoder that sees nothing."""

    latent_dim = 3

    def forward(self, window):
        return torch.full((len(window), 3), 0.5)


@pytest.fixture
def env():
    env = make_push_env(RAYS, seed=0)
    yield env
    env.close()


def test_specs_hold(env):
    check_env_specs(env, break_when_any_done="both")


def test_images_stay_behind_unless_they_are_asked_for(env):
    images = {"depth", "segmentation", "occupancy", "window"}
    assert not images & set(env.reset().keys())
    keeping = make_push_env(RAYS, keep_images=True)
    assert images <= set(keeping.reset().keys())
    keeping.close()


def test_every_part_can_be_replaced():
    env = make_push_env(
        replace(RAYS, reward=RewardConfig(weights={"goal": 1.0, "constant": 2.0}, scale=1.0)),
        encoder=Nothing(),
        planner=StraightLine(),
        entries=["latent", ("twice", Entry(lambda inputs: inputs.contact, 2.0))],
        reward_terms={"constant": lambda outcome: torch.ones_like(outcome.path_fraction)},
        curriculum=Curriculum(),
        seed=1,
    )
    td = env.reset()
    assert torch.equal(td["observation"][:, :3], torch.zeros(2, 3))  # as on an empty table
    assert torch.equal(td["latent"], torch.full((2, 3), 0.5))
    distance = (td["goal_position"] - td["object_pose"][:, :2]).norm(dim=-1)
    torch.testing.assert_close(td["path_length"][:, 0], distance)  # a straight line
    assert distance.max() < 0.07  # the curriculum's first stage
    td = env.step(td.set("action", torch.zeros(2, 3)))
    assert (td["next", "reward"] == 2.0).all()
    env.close()


@pytest.mark.parametrize("encoder", ["rays", "vae"])
def test_in_free_space_the_latent_is_silent(encoder):
    env = make_push_env(RAYS.with_fields(encoder=encoder, scene="free"), seed=0)
    latent = env.reset()["observation"][:, :32]
    torch.testing.assert_close(latent, torch.zeros(2, 32), atol=1e-5, rtol=0)
    env.close()


def test_the_same_in_parallel_workers_as_in_one_process():
    config = replace(RAYS, num_envs=1)
    actions = [torch.rand(1, 3) * 2 - 1 for _ in range(6)]
    alone = make_push_env(config, seed=5)
    parallel = ParallelEnv(1, partial(make_push_env, config, seed=5))
    try:
        one, many = alone.reset(), parallel.reset()
        for action in actions:
            one = step_mdp(alone.step(one.set("action", action)))
            many = step_mdp(parallel.step(many.set("action", action[None])))
            for key in ("observation", "subgoal_history", "reward_start"):
                torch.testing.assert_close(many[key][0], one[key], msg=key)
        check_env_specs(parallel)
    finally:
        alone.close()
        parallel.close()


def test_a_scenario_takes_the_place_of_the_configs_scenes():
    scenario = ScenarioConfig(scene="slot", distance=(0.2, 0.25), difficulty=1.0)
    env = make_push_env(RAYS, scenario=scenario, seed=0)
    env.reset()
    assert env.base_env.scenario == replace(scenario, path_inflation="inscribed")
    assert {start.scene for start in env.base_env.scenarios} == {"slot"}
    env.close()


def test_text_stands_for_parts_as_in_the_config():
    named = replace(RAYS, planner="straight_line", encoder="tests.own_parts:MeanHeight")
    env = make_push_env(replace(named, add=("tests.own_parts:goal_direction",)), seed=0)
    other = make_push_env(
        RAYS,
        planner=StraightLine(),
        encoder=MeanHeight(),
        entries=[*PATH_AHEAD_ENTRIES, goal_direction],
        seed=0,
    )
    one, two = env.reset(), other.reset()
    assert one["latent"].shape == (2, 4)
    assert torch.equal(one["observation"], two["observation"])
    env.close()
    other.close()


def test_end_to_end_emits_the_window_as_bytes():
    env = make_push_env(replace(RAYS, encoder="end_to_end", window_size=32), seed=0)
    check_env_specs(env)
    window = env.reset()["window"]
    assert window.dtype == torch.uint8
    assert window.shape == (2, 1, 32, 32)
    assert "latent" not in env.observation_spec.keys()
    keeping = make_push_env(replace(RAYS, window_outside="blocked"), keep_images=True, seed=0)
    assert keeping.reset()["window"].max() > 0
    env.close()
    keeping.close()


@pytest.mark.parametrize(
    ("inflation", "attribute"), [("inscribed", "inscribed_radius"), ("circumscribed", "radius")]
)
def test_obstacles_are_inflated_by_the_size_of_each_scene_s_object(inflation, attribute):
    bar = PushedObject(name="bar", parts=(box(0.12, 0.03, 0.05),))
    objects = (OBJECTS["small_cylinder"], bar)
    config = replace(RAYS, num_envs=len(objects), inflation=inflation, planner_margin=None)
    env = make_push_env(config, pushed_object=objects, keep_images=True, seed=0)
    scenario = sample_scenario(np.random.default_rng(0), ScenarioConfig(scene="posts"))
    td = env.reset(scenarios=[replace(scenario, pushed_object=item.name) for item in objects])
    for state, item in zip(td, objects, strict=True):
        images = state[None].select("depth", "segmentation")
        expected = OccupancyGrid(inflation=getattr(item, attribute))(images)["occupancy"]
        assert torch.equal(state["occupancy"], expected[0]), item.name
    env.close()


@pytest.mark.parametrize("margin", [0.0, 0.03, None])
def test_paths_leave_the_workspace_by_no_more_than_the_margin(margin):
    config = RAYS.with_fields(scene="free", planner_margin=margin)
    env = make_push_env(config, keep_images=True, seed=0)
    blocked = env.reset()["occupancy"][0, 0]
    side = OccupancyGrid().camera.cell_size
    free = (~blocked).sum(-1).max() * side, (~blocked).sum(-2).max() * side
    if margin is None:
        assert not blocked.any()
    else:
        expected = sorted([0.55 + 2 * margin, 0.70 + 2 * margin])
        assert sorted(float(f) for f in free) == pytest.approx(expected, abs=2 * side)
    env.close()


def test_the_inflation_that_is_given_also_decides_which_episodes_are_drawn():
    config = RAYS.with_fields(scene="diagonal_walls", inflation="inscribed")
    env = make_push_env(config, inflation="circumscribed", seed=0)
    assert env.base_env.scenario.path_inflation == "circumscribed"
    with pytest.raises(ValueError, match="In 'diagonal_walls' a path needs path_inflation='inscr"):
        env.reset()  # instead of episodes without a path
    env.close()
    env = make_push_env(replace(config, inflation="circumscribed"), inflation="widest", seed=0)
    assert env.reset()["path_found"].all()
    env.close()


def test_a_printed_environment_shows_the_settings_of_its_parts():
    env = make_push_env(RAYS, recovery=True, seed=0)
    _ = env.observation_spec
    text = str(env)
    for part in (
        "PushEnv(2, scenario=ScenarioConfig(scene=('posts',)",
        "PlannerSubgoals(planner='distance_field', mode='lookahead', lookahead=0.2",
        "EgocentricWindow(frame='path', size=64",
        "PushObservation(frame='path', raw=False, entries=['latent', 'ee_position'",
        "StuckRecovery(patience=4",
    ):
        assert part in text, text
    env.close()


def test_the_window_has_the_scale_of_its_encoder():
    env = make_push_env(RAYS, encoder=RayScan(8, window_size=32, pixel_size=0.002), seed=0)
    window = environment_fingerprint(env)["window"]
    env.close()
    assert (window["size"], window["metres_per_pixel"]) == (32, 0.002)
    encoder = RayScan(8)
    encoder.metres_per_pixel = 0.0
    with pytest.raises(TypeError, match="metres_per_pixel must be a positive number"):
        make_push_env(RAYS, encoder=encoder)
