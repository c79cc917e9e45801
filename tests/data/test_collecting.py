"""Demonstrations replay to the last bit, and an interrupt leaves the episodes until then."""

import itertools
import json
from dataclasses import asdict, replace
from pathlib import Path

import minari
import numpy as np
import pytest
import torch
from tensordict import TensorDict

from modpush.data import CollectConfig, collect_demonstrations, collecting, load_demonstrations
from modpush.data.collecting import card_text, episode_seed
from modpush.envs import PushEnv, Scenario
from modpush.evaluation.set_recipes import RECIPES
from modpush.files import load_yaml
from modpush.recipes import PushEnvConfig
from tests.data.conftest import CONFIG, ENV


def dataset(folder: Path) -> minari.MinariDataset:
    return minari.MinariDataset(folder / "minari" / "modpush" / "push-v0" / "data")


def metadata(found: minari.MinariDataset) -> list[dict]:
    return list(found.storage.get_episode_metadata(range(len(found))))


def test_commands_lead_from_the_stored_start_to_the_same_states(collected) -> None:
    env = PushEnv(1, pushed_object="small_cube")
    found = dataset(collected)
    for about, episode in zip(metadata(found), found, strict=True):
        assert len(episode) > 5
        td = env.reset(scenarios=[Scenario.from_dict(json.loads(about["scenario"]))])
        for t, command in enumerate(torch.from_numpy(episode.infos["command"]), 1):
            td = env.step(td.set("action", command[None]))["next"]
            for key in ("object_pose", "ee_pose", "success", "object_contact"):
                recorded = np.atleast_1d(episode.infos[key][t])
                np.testing.assert_array_equal(td[key][0].numpy(), recorded)
            np.testing.assert_array_equal(td["depth"][0, 0].numpy(), episode.infos["depth"][t])
    env.close()


def test_minaris_environment_replays_an_episode_to_the_last_bit(collected) -> None:
    found = dataset(collected)
    env = found.recover_environment()
    assert env.observation_space == found.observation_space
    known = metadata(found)
    assert [episode["policy"] for episode in known] == ["scripted"] * 3 + ["corridor"] * 3
    for number in (2, 5):
        episode = found[number]
        observation, _ = env.reset(seed=known[number]["seed"])
        np.testing.assert_array_equal(observation, episode.observations[0])
        for t, action in enumerate(episode.actions):
            observation, reward, terminated, truncated, info = env.step(action)
            np.testing.assert_array_equal(observation, episode.observations[t + 1])
            assert np.float32(reward) == episode.rewards[t]
            assert (terminated, truncated) == (episode.terminations[t], episode.truncations[t])
            assert info["object_contact"] == episode.infos["object_contact"][t + 1]
        assert terminated or truncated
        assert info["success"] == known[number]["success"]
        assert json.loads(known[number]["scenario"])["scene"] in ENV.scenario.scene
    env.close()


def test_an_interrupted_run_leaves_the_episodes_until_then(tmp_path, monkeypatch) -> None:
    run_episodes = collecting.run_episodes

    def interrupted(*args, **options):
        yield from itertools.islice(run_episodes(*args, **options), 2)
        raise KeyboardInterrupt

    monkeypatch.setattr(collecting, "run_episodes", interrupted)
    (tmp_path / "minari/modpush/push-v0/.unfinished").mkdir(parents=True)  # of a killed process
    with pytest.raises(KeyboardInterrupt):
        collect_demonstrations(replace(CONFIG, out=tmp_path), progress=False)
    found = dataset(tmp_path)
    assert [episode["policy"] for episode in metadata(found)] == ["scripted"] * 2
    assert found.storage.metadata["modpush"]["policies"]["scripted"]["kept"] == 2
    assert "scripted" in (tmp_path / "README.md").read_text()


def test_a_folder_with_demonstrations_is_refused(collected, tmp_path) -> None:
    with pytest.raises(FileExistsError, match="holds a data set; choose another folder"):
        collect_demonstrations(replace(CONFIG, out=collected), progress=False)
    with pytest.raises(ValueError, match="no 'nobody', expected agent, corridor"):
        collect_demonstrations(CollectConfig(policy=("nobody",), out=tmp_path), progress=False)


def test_only_success_keeps_episodes_that_reached_the_goal(tmp_path, monkeypatch) -> None:
    short = replace(ENV.simulation, max_episode_steps=40)
    config = replace(
        CONFIG,
        policy=("scripted",),
        episodes=2,
        only_success=True,
        images=False,
        env=replace(ENV, simulation=short),
        out=tmp_path,
    )
    collect_demonstrations(config, progress=False)
    found = dataset(tmp_path)
    assert len(found) >= 2
    assert all(episode["success"] for episode in metadata(found))
    assert "depth" not in found[0].infos
    counts = found.storage.metadata["modpush"]["policies"]["scripted"]
    assert counts["kept"] == counts["solved"] == len(found) < counts["tried"]
    monkeypatch.setattr(collecting, "MAX_NUMBER", 4)  # else it tries 30 episodes
    short = replace(ENV.simulation, max_episode_steps=1)
    hopeless = replace(
        config, episodes=1, env=replace(ENV, simulation=short), out=tmp_path / "none"
    )
    with pytest.raises(ValueError, match=r"'scripted' reached the goal in 0 of \d+ episodes"):
        collect_demonstrations(hopeless, progress=False)


def test_no_start_is_drawn_as_one_of_an_evaluation_set() -> None:
    seeds = [episode_seed(seed, number) for seed in (0, 3000) for number in (0, 999_999)]
    assert min(seeds) > 20_221_023  # held out in training; the sets' own are smaller
    assert max(seeds) < 2**32  # one word: two of them could be a set's and an episode's number
    states = {np.random.SeedSequence(seed).generate_state(1)[0] for seed in seeds}
    assert max(recipe.count for recipe in RECIPES.values()) < min(seeds)
    assert len(states) == len(seeds)


def test_actions_are_turned_and_kept_in_their_box(collected) -> None:
    for episode in dataset(collected):
        command = episode.infos["command"]
        assert np.abs(episode.actions).max() <= 1
        # The direction is turned, the yaw increment is not.
        np.testing.assert_array_equal(episode.actions[:, 2], command[:, 2])
        lengths = [np.linalg.norm(a[:, :2], axis=1) for a in (episode.actions, command)]
        np.testing.assert_allclose(*lengths, atol=1e-6)


def test_the_card_tells_the_policies_and_the_environment() -> None:
    env = PushEnvConfig.preset("cpu", robot="panda", tool="rod", engine="mujoco")
    policy = {"described": {"class": "a:B"}, "kept": 1, "steps": 9, "solved": 1, "tried": 1}
    about = {
        "policies": {"scripted": policy},
        "only_success": False,
        "images": True,
        "env": json.loads(json.dumps(asdict(env))),
    }
    text = card_text(replace(CONFIG, env=env), about)
    told = load_yaml(text.partition("```yaml\n")[2].partition("```")[0])
    assert told == about
    assert told["env"]["simulation"]["robot"] == "panda"


def test_another_arm_tool_and_engine_are_recorded_and_replayed(tmp_path) -> None:
    parts = {"robot": "panda", "tool": "rod", "engine": "mujoco"}
    env = PushEnvConfig.preset("cpu", num_envs=1, encoder="rays", scene="free", **parts)
    config = CollectConfig(policy=("scripted",), episodes=1, env=env, out=tmp_path)
    demonstrations = load_demonstrations(collect_demonstrations(config, progress=False))
    (episode,) = dataset(tmp_path)
    simulator = demonstrations.make_env(num_envs=1).base_env
    found = {"robot": simulator.robot.name, "tool": simulator.tool.name}
    assert {**found, "engine": simulator.engine_name} == parts
    (about,) = metadata(dataset(tmp_path))
    simulator.reset(scenarios=[Scenario.from_dict(json.loads(about["scenario"]))])
    for t, command in enumerate(torch.from_numpy(episode.infos["command"]), 1):
        td = simulator.step(TensorDict(action=command[None], batch_size=[1]))["next"]
        np.testing.assert_array_equal(td["ee_pose"][0].numpy(), episode.infos["ee_pose"][t])
    simulator.close()
