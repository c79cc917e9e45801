"""The batched GPU simulation. Skipped where there is no CUDA device."""

import pytest
import torch
from torchrl.envs.utils import check_env_specs

from modpush.agents import ScriptedPusher
from modpush.envs import OBSTACLE_SCENES, PushEnv

pytestmark = [
    pytest.mark.gpu,
    pytest.mark.skipif(not torch.cuda.is_available(), reason="no CUDA device"),
]


@pytest.fixture(scope="module")
def env():
    env = PushEnv(16, scene=OBSTACLE_SCENES, device="cuda", depth=None, seed=0)
    yield env
    env.close()


def test_specs(env) -> None:
    check_env_specs(env, break_when_any_done="both")


def test_partial_reset_leaves_the_others_alone(env) -> None:
    td = env.rand_step(env.reset())["next"]
    mask = torch.zeros(16, 1, dtype=torch.bool, device="cuda")
    mask[3] = True
    after = env.reset(td.clone().set("_reset", mask))
    others = ~mask[:, 0]
    torch.testing.assert_close(after["object_pose"][others], td["object_pose"][others])


def test_state_round_trip(env) -> None:
    td = env.rand_step(env.reset())["next"]
    state = env.get_state()
    env.reset()
    torch.testing.assert_close(env.set_state(state)["object_pose"], td["object_pose"])


def test_the_scripted_pusher_succeeds_as_on_the_cpu() -> None:
    env, policy = PushEnv(64, device="cuda", depth=None, seed=0), ScriptedPusher()
    td, success = env.reset(), torch.zeros(64, dtype=torch.bool, device="cuda")
    for _ in range(200):
        td = env.step(policy(td))["next"]
        success |= td["success"][:, 0]
    env.close()
    assert success.float().mean() >= 0.9


def test_images_are_those_of_the_scenes() -> None:
    env = PushEnv(4, device="cuda", scene="posts", seed=0)
    td = env.reset()
    assert td["depth"].is_cuda
    assert (td["segmentation"] == 1).flatten(1).any(1).all()
    env.close()
