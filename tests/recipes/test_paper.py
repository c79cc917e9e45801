"""The paper's stack, as one call, and agents on disk."""

import json
from dataclasses import replace
from functools import partial

import pytest
import safetensors
import safetensors.torch
import torch
from torch import nn
from torchrl.data import Bounded
from torchrl.envs import ParallelEnv, check_env_specs
from torchrl.envs.utils import step_mdp

from modpush.agents.tqc.networks import make_actor
from modpush.geometry import rotate
from modpush.mdp import Curriculum, Entry, RewardConfig
from modpush.planners import StraightLine
from modpush.recipes.paper import (
    PushEnvConfig,
    config_from_dict,
    load_agent,
    make_push_env,
    save_agent,
)

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


def test_the_papers_observation_has_49_values():
    env = make_push_env(PushEnvConfig.preset("paper", num_envs=1, encoder="rays"))
    assert env.observation_spec["observation"].shape == (1, 49)
    env.close()


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


def test_without_an_encoder_there_is_no_latent():
    env = make_push_env(replace(RAYS, encoder="none"))
    assert env.observation_spec["observation"].shape == (2, 22)
    assert "latent" not in env.observation_spec.keys()
    env.close()


@pytest.mark.parametrize("encoder", ["rays", "vae"])
def test_in_free_space_the_latent_is_silent(encoder):
    env = make_push_env(replace(RAYS, encoder=encoder, scene=("free",)), seed=0)
    latent = env.reset()["observation"][:, :32]
    torch.testing.assert_close(latent, torch.zeros(2, 32), atol=1e-5, rtol=0)
    env.close()


def test_forward_in_the_path_frame_moves_the_tool_along_the_way(env):
    td = env.reset()
    ahead = td["subgoal"] - td["object_pose"][:, :2]
    before = td["ee_pose"][:, :2].clone()
    after = env.step(td.set("action", torch.tensor([[1.0, 0.0, 0.0]] * 2)))["next", "ee_pose"]
    yaw = torch.atan2(ahead[:, 1:], ahead[:, :1])
    moved = rotate(after[:, :2] - before, -yaw)
    assert (moved[:, 0] > 0.008).all()
    assert (moved[:, 1].abs() < 0.2 * moved[:, 0]).all()


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
    finally:
        alone.close()
        parallel.close()


def test_unknown_names_are_answered_with_what_there_is():
    with pytest.raises(ValueError, match=r"encoder must be one of .*'rays'.* got 'eyes'"):
        PushEnvConfig(encoder="eyes")
    with pytest.raises(ValueError, match=r"planner must be one of .*'a_star'.* got 'luck'"):
        PushEnvConfig(planner="luck")
    with pytest.raises(ValueError, match="there is no 'duck'"):
        PushEnvConfig(pushed_object="duck")
    with pytest.raises(ValueError, match="preset must be one of"):
        PushEnvConfig.preset("gpu")


def test_a_config_survives_json():
    config = PushEnvConfig.preset("cpu")
    assert config_from_dict(PushEnvConfig, json.loads(json.dumps(_asdict(config)))) == config


def test_a_config_with_an_unknown_field_is_refused():
    with pytest.raises(ValueError, match=r"PushEnvConfig: .*colour"):
        config_from_dict(PushEnvConfig, {"colour": "red"})


def _asdict(config):
    from dataclasses import asdict

    return asdict(config)


@pytest.fixture
def saved(tmp_path):
    spec = Bounded(-1.0, 1.0, (3,), dtype=torch.float32)
    actor = make_actor(54, spec, (16, 8))
    path = tmp_path / "agent.safetensors"
    save_agent(path, actor, RAYS, hidden_sizes=(16, 8), observation_dim=54, metadata={"steps": 7})
    return path, actor


def test_an_agent_comes_back_as_it_was_and_acts(saved):
    path, actor = saved
    agent = load_agent(path)
    assert agent.config == RAYS
    assert agent.metadata == {"steps": 7}
    env = agent.make_env(num_envs=2, seed=0)
    td = env.reset()
    assert torch.equal(agent.policy(td.clone())["loc"], actor(td.clone())["loc"])
    rollout = env.rollout(3, agent.policy, break_when_any_done=False)
    assert rollout["action"].abs().max() <= 1
    env.close()


def test_a_truncated_agent_is_refused(saved):
    path, _ = saved
    path.write_bytes(path.read_bytes()[:-100])
    with pytest.raises(ValueError, match="not a whole safetensors file"):
        load_agent(path)


def test_a_file_of_something_else_is_refused(tmp_path):
    path = tmp_path / "other.safetensors"
    safetensors.torch.save_file({"x": torch.zeros(1)}, path)
    with pytest.raises(ValueError, match="format None, expected 'modpush-agent"):
        load_agent(path)


def test_an_agent_of_an_earlier_format_is_refused(saved):
    path, _ = saved
    with safetensors.safe_open(path, framework="pt") as file:
        header, tensors = file.metadata(), {key: file.get_tensor(key) for key in file.keys()}
    safetensors.torch.save_file(tensors, path, metadata={**header, "format": "modpush-agent-1"})
    with pytest.raises(ValueError, match=r"'modpush-agent-1', expected .* trained anew"):
        load_agent(path)


def test_weights_of_another_network_are_refused(saved):
    path, _ = saved
    with safetensors.safe_open(path, framework="pt") as file:
        header, tensors = file.metadata(), {key: file.get_tensor(key) for key in file.keys()}
    header["network"] = json.dumps({"hidden_sizes": [32, 8], "observation_dim": 54})
    safetensors.torch.save_file(tensors, path, metadata=header)
    with pytest.raises(ValueError, match="do not fit its config"):
        load_agent(path)


def test_an_unknown_agent_is_answered_with_those_there_are():
    with pytest.raises(ValueError, match=r"no agent 'duck', expected a file or one of \["):
        load_agent("duck")
