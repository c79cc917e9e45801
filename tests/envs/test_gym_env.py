import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from stable_baselines3 import SAC
from stable_baselines3.common.env_checker import check_env as check_env_of_sb3
from torchrl.envs import GymEnv
from torchrl.envs.utils import check_env_specs

from tests.envs.engines.sapien.test_agent import scenario


@pytest.fixture
def env():
    env = gym.make("ClutterPushState-v1", scene="posts", render_mode="rgb_array")
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


def test_a_given_scenario_and_its_end(env) -> None:
    where = scenario((0.40, 0.0, np.pi / 2), (0.50, 0.0, 0.0), goal_position=(0.60, 0.0))
    observation, _ = env.reset(options={"scenario": where})
    assert observation[:5] == pytest.approx([0.5, 0, 0, 0.6, 0], abs=1e-5)
    terminated = False
    while not terminated:
        _, reward, terminated, truncated, info = env.step(np.array([1, 0, 0], np.float32))
        assert not truncated
    assert reward == 1.0
    assert info["is_success"] is True
    picture = env.render()
    assert picture.dtype == np.uint8
    assert picture.std() > 10


def test_torchrls_gym_env() -> None:
    env = GymEnv("ClutterPushState-v1", scene="slot")
    check_env_specs(env)
    assert env.rollout(3)["next", "observation"].shape == (3, 17)
    env.close()


def test_goal_poses_are_observed_with_their_yaw() -> None:
    env = gym.make("ClutterPushState-v1", goal="pose", pushed_object="box")
    observation, _ = env.reset(seed=3)
    assert observation.shape == (18,)
    assert observation[5] == pytest.approx(env.unwrapped.simulator.scenarios[0].goal_yaw, abs=1e-6)
    check_env(env.unwrapped)
    env.close()
