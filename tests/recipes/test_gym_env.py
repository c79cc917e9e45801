"""`modpush/Push-v0`: the stack of `make_push_env` through Gymnasium's front door."""

import gymnasium as gym
import numpy as np
import pytest
import torch
from gymnasium.utils.env_checker import check_env
from stable_baselines3 import SAC
from stable_baselines3.common.env_checker import check_env as check_env_of_sb3
from tensordict import TensorDict
from torchrl.envs import GymEnv
from torchrl.envs.utils import check_env_specs, step_mdp

import modpush.envs  # noqa: F401  # registers the environment
from modpush.data import CollectConfig
from modpush.encoders import RayScan
from modpush.planners import OccupancyGrid
from modpush.recipes import PaperGymEnv, PushEnvConfig, PushGymEnv, load_agent, make_push_env
from tests.envs.engines.sapien.test_agent import scenario


@pytest.fixture
def env():
    env = gym.make("modpush/Push-v0", scene="posts", encoder="rays", render_mode="rgb_array")
    yield env
    env.close()


def test_gymnasiums_and_stable_baselines_own_checks(env) -> None:
    check_env(env.unwrapped)
    check_env_of_sb3(env.unwrapped)


def test_stable_baselines_learns_on_it(env) -> None:
    model = SAC(
        "MlpPolicy", env, learning_starts=20, batch_size=16, policy_kwargs={"net_arch": [16]}
    )
    before = model.policy.actor.mu.weight.clone()
    model.learn(60)
    assert not (model.policy.actor.mu.weight == before).all()


def test_torchrls_gym_env_takes_it() -> None:
    env = GymEnv("modpush/Push-v0", scene="slot", encoder="none")
    check_env_specs(env)
    env.close()


def test_a_given_scenario_and_its_end() -> None:
    env = PushGymEnv("paper", encoder="none", render_mode="rgb_array")  # acts in the base frame
    where = scenario((0.40, 0.0, np.pi / 2), (0.50, 0.0, 0.0), goal_position=(0.60, 0.0))
    env.reset(options={"scenario": where})
    assert env.simulator.scenarios == [where]
    terminated = False
    while not terminated:
        _, _, terminated, truncated, info = env.step(np.array([1, 0, 0], np.float32))
        assert not truncated
    assert info["is_success"] is True
    picture = env.render()
    assert picture.dtype == np.uint8
    assert picture.std() > 10
    env.close()


def test_observation_and_reward_are_make_push_env_s() -> None:
    task = PushGymEnv("paper", encoder="rays", scene="slot", difficulty=0.5)
    config = PushEnvConfig.preset("paper", num_envs=1, encoder="rays")
    env = make_push_env(config, scene="slot", difficulty=0.5)
    observation, _ = task.reset(seed=3)
    state = env.reset(seed=3)
    generator = np.random.default_rng(0)
    for _ in range(10):
        np.testing.assert_array_equal(observation, state["observation"][0])
        action = generator.uniform(-1, 1, 3).astype(np.float32)
        observation, reward, terminated, truncated, info = task.step(action)
        stepped = env.step(state.set("action", torch.from_numpy(action)[None]))
        assert reward == stepped["next", "reward"].item()
        assert info["object_contact"] == stepped["next", "object_contact"].item()
        assert not terminated
        assert not truncated
        state = step_mdp(stepped)
    assert next(iter(task.columns)) == "latent"
    task.close()
    env.close()


def test_the_shipped_agent_pushes_through_it() -> None:
    agent = load_agent("small_cube")
    env = gym.make("modpush/Push-v0", scene="slot", difficulty=0.3)
    observation, _ = env.reset(seed=0)
    done = False
    while not done:
        state = TensorDict({"observation": torch.from_numpy(observation)[None]}, [1])
        action = agent.actor(state)["action"][0].numpy()
        observation, _, terminated, truncated, info = env.step(action)
        done = terminated or truncated
    assert info["is_success"]
    env.close()


def test_options_are_obeyed_or_refused() -> None:
    env = PushGymEnv(
        encoder=RayScan(num_rays=8), leave_out=("edges",), pushed_object="large_cube", seed=0
    )
    assert env.columns["latent"] == slice(0, 8)
    assert "edges" not in env.columns
    env.reset()
    assert env.simulator.scenarios[0].pushed_object == "large_cube"
    env.close()
    with pytest.raises(TypeError, match=r"unexpected keyword argument 'scnee'; expected some of"):
        PushGymEnv(scnee="slot")
    with pytest.raises(ValueError, match=r"one scene, got num_envs=4; for several use .*make_vec"):
        gym.make("modpush/Push-v0", num_envs=4)
    known = r"\['authors', 'cpu', 'paper'\]"
    with pytest.raises(ValueError, match=f"preset must be one of {known}, got 'gpu'"):
        PushGymEnv("gpu")
    with pytest.raises(ValueError, match="'end_to_end' has an image beside the observation"):
        PushGymEnv(encoder="end_to_end")
    with pytest.raises(ValueError, match="render_mode must be None or 'rgb_array', got 'human'"):
        PushGymEnv(render_mode="human")


def test_a_video_has_as_many_pictures_per_second_as_there_are_steps() -> None:
    for options, rate in (({}, 15), ({"control_freq": 10}, 10)):
        env = gym.make("modpush/Push-v0", scene="free", encoder="none", **options)
        assert env.metadata == {"render_modes": ["rgb_array"], "render_fps": rate}
        env.close()


@pytest.mark.parametrize("preset", ["paper", "authors", "cpu"])
def test_a_preset_whose_fields_are_all_given_is_that_of_make_push_env(preset) -> None:
    config = PushEnvConfig.preset(preset, num_envs=1, encoder="none")
    env = gym.make("modpush/Push-v0", **CollectConfig(env=config).env_options())
    expected = make_push_env(config)
    for made in (env.unwrapped.env, expected):
        made.set_seed(0)
    assert env.unwrapped.env.base_env.scenario == expected.base_env.scenario
    grids = [
        next(t for t in made.transform if isinstance(t, OccupancyGrid))
        for made in (env.unwrapped.env, expected)
    ]
    assert grids[0].margins == grids[1].margins
    env.close()
    expected.close()


def test_the_former_name_is_the_same_class() -> None:
    assert PaperGymEnv is PushGymEnv
