"""Agents on disk."""

from dataclasses import replace

import pytest
import torch
from tensordict.nn import TensorDictModule
from torchrl.data import Bounded

from modpush.agents.tqc.networks import make_actor
from modpush.encoders import DepthVAE, RayScan
from modpush.mdp import PATH_AHEAD_ENTRIES, PushObservation, StuckRecovery
from modpush.recipes import (
    PushEnvConfig,
    environment_fingerprint,
    load_agent,
    make_push_env,
    save_agent,
)
from modpush.recipes.fingerprint import fingerprint_differences
from tests.own_parts import MeanHeight, one_post

RAYS = PushEnvConfig.preset("cpu", num_envs=2, encoder="rays", scene="posts")


@pytest.fixture(scope="module")
def fingerprint():
    env = make_push_env(RAYS)
    found = environment_fingerprint(env)
    env.close()
    return found


def save(path, config=RAYS, **options):
    spec = Bounded(-1.0, 1.0, (3,), dtype=torch.float32)
    actor = make_actor(options.pop("width", 55), spec, (16, 8))
    options = {"metadata": {"steps": 7}, "hidden_sizes": (16, 8), **options}
    save_agent(path, actor, config, **options)
    return actor


@pytest.fixture
def saved(tmp_path, fingerprint):
    path = tmp_path / "agent.safetensors"
    return path, save(path, observation_dim=55, fingerprint=fingerprint)


def test_the_object_s_axis_means_for_other_objects_what_the_agent_was_trained_with(saved):
    env = load_agent(saved[0]).make_env(num_envs=1, seed=0, pushed_object="fragment")
    td = env.reset()
    columns = next(t.columns for t in env.transform if isinstance(t, PushObservation))
    to_subgoal = td["subgoal"] - td["object_pose"][:, :2]
    ahead = torch.atan2(to_subgoal[:, 1], to_subgoal[:, 0])
    angle = 4 * (td["object_pose"][:, 2] - ahead)  # the small cube looks alike at four yaw angles
    assert td["object_symmetry"].item() == 1
    torch.testing.assert_close(
        td["observation"][:, columns["object_axis"]],
        torch.stack([angle.cos(), angle.sin()], -1),
        atol=1e-5,
        rtol=0,
    )
    env.close()


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


def test_an_agent_whose_config_says_so_recovers(tmp_path):
    path = tmp_path / "agent.safetensors"
    config = replace(RAYS, recovery=True, num_envs=1)
    save(path, config, observation_dim=55, fingerprint={})

    def without(config, **parts):  # an environment of one's own that does not know the field
        return make_push_env(replace(config, recovery=False), **parts)

    for agent in (load_agent(path), load_agent(path, make_env=without)):
        still = TensorDictModule(
            lambda o: torch.zeros(*o.shape[:-1], 3), ["observation"], ["action"]
        )
        agent = replace(agent, actor=still)
        env = agent.make_env(seed=0)
        assert sum(isinstance(t, StuckRecovery) for t in env.transform) == 1
        moved = env.rollout(10, agent.policy)["action"].any(-1)
        assert moved.tolist() == [[False] * 4 + [True] * 4 + [False] * 2]
        alone = env.rollout(10, agent.actor)["action"]
        assert not alone.any()
        env.close()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"encoder": RayScan(num_rays=16)}, r"values of 'latent': 32 -> 16"),
        ({"entries": PATH_AHEAD_ENTRIES[:-1]}, "entries:"),
    ],
)
def test_another_environment_is_refused(saved, options, message):
    with pytest.raises(ValueError, match=message):
        load_agent(saved[0]).make_env(**options)


def test_a_file_runs_no_code_unless_its_reader_allows_it(tmp_path, fingerprint):
    path = tmp_path / "agent.safetensors"
    config = replace(RAYS, encoder="tests.own_parts:MeanHeight")
    save(path, config, observation_dim=55, fingerprint=fingerprint)
    with pytest.raises(
        ValueError, match=r"parts in \['tests.own_parts'\], which are imported only"
    ):
        load_agent(path)
    assert load_agent(path, allow=("tests",)).config == config
    given = load_agent(path, parts={"encoder": MeanHeight()})
    assert isinstance(given.parts["encoder"], MeanHeight)


def test_parts_given_as_objects_are_remembered_as_far_as_they_can_be(tmp_path):
    path = tmp_path / "agent.safetensors"
    parts = {"encoder": MeanHeight(2.0), "scene": one_post}
    env = make_push_env(RAYS, **parts)
    width = env.observation_spec["observation"].shape[-1]
    save(
        path,
        width=width,
        observation_dim=width,
        fingerprint=environment_fingerprint(env),
        parts=parts,
    )
    env.close()
    with pytest.raises(ValueError, match=r"\['tests.own_parts'\]"):
        load_agent(path)  # the scene can be imported, but only if the reader says so
    agent = load_agent(path, allow=["tests.own_parts"])
    with pytest.raises(ValueError, match=r"'encoder': 'tests.own_parts:MeanHeight'.*par"):
        agent.make_env()
    with pytest.raises(ValueError, match="encoder: trained with"):
        load_agent(path, allow=["tests"], parts={"encoder": MeanHeight(1.0)}).make_env()
    env = load_agent(path, allow=["tests"], parts={"encoder": MeanHeight(2.0)}).make_env()
    assert env.reset()["latent"].shape == (2, 4)
    assert [scenario.scene for scenario in env.base_env.scenarios] == [
        "tests.own_parts:one_post"
    ] * 2
    env.close()


@pytest.mark.parametrize(
    ("change", "name"),
    [({"subgoal_lags": (1, 3)}, "subgoals"), ({"path_ahead": (0.1, 0.2, 0.4)}, "subgoals")],
)
def test_other_sub_goals_are_another_environment(fingerprint, change, name):
    env = make_push_env(replace(RAYS, **change))
    now = environment_fingerprint(env)
    env.close()
    (difference,) = fingerprint_differences(fingerprint, now)
    assert difference.startswith(f"{name}: trained with")
    earlier = {key: value for key, value in fingerprint.items() if key != "subgoals"}
    assert fingerprint_differences(earlier, now) == []  # files from before say nothing of it


def test_an_agent_whose_encoder_is_a_file_loads_anywhere(tmp_path, monkeypatch):
    (tmp_path / "here").mkdir()
    (tmp_path / "there").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    DepthVAE(32).save("mine.safetensors")
    config = PushEnvConfig.preset("cpu", num_envs=1, encoder="mine.safetensors")
    env = make_push_env(config)
    width = env.observation_spec["observation"].shape[-1]
    known = environment_fingerprint(env)
    save("agent.safetensors", config, width=width, observation_dim=width, fingerprint=known)
    env.close()
    encoder = DepthVAE.from_pretrained("mine.safetensors")
    monkeypatch.chdir(tmp_path / "there")
    agent = load_agent("../here/agent.safetensors")
    with pytest.raises(ValueError, match=r"'mine.safetensors', which is not in .*there.*parts="):
        agent.make_env()
    load_agent("../here/agent.safetensors", parts={"encoder": encoder}).make_env().close()
