"""Demonstrations are what happened: they replay to the last bit, and a killed run goes on."""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import gymnasium
import h5py
import minari
import numpy as np
import pandas as pd
import pytest

from modpush.data import (
    CollectConfig,
    Demonstration,
    collect_demonstrations,
    collecting,
    replay_demonstration,
)
from modpush.data.collecting import _start
from modpush.data.config import episode_seed
from modpush.envs import PushEnv
from modpush.evaluation.sets import SET_NAMES, load_set
from modpush.evaluation.shortest import shortest_path
from modpush.recipes import PushEnvConfig
from tests.data.conftest import CONFIG, ENV


def episodes(folder: Path) -> list[Demonstration]:
    return [Demonstration.load(path) for path in sorted(folder.glob("episodes/*/*.npz"))]


def dataset(folder: Path) -> minari.MinariDataset:
    return minari.MinariDataset(folder / "minari" / "modpush" / "push-v0" / "data")


def test_from_the_stored_start_and_actions_come_the_same_states_to_the_last_bit(collected) -> None:
    env = PushEnv(1, pushed_object="small_cube")
    for found in episodes(collected):
        assert len(found) > 5
        seen = replay_demonstration(found, env)
        np.testing.assert_array_equal(seen["physics"].numpy(), found.physics)
        for key, value in found.poses.items():
            np.testing.assert_array_equal(seen[key].numpy(), value)
        for key, flags in found.flags.items():
            np.testing.assert_array_equal(seen[key][:, 0].numpy(), flags)
        np.testing.assert_array_equal(seen["depth"][:, 0].numpy(), found.depth)
    env.close()


def test_what_the_agent_did_replays_to_the_last_bit(tmp_path: Path) -> None:
    config = replace(CONFIG, policy=("agent",), episodes=2, out=tmp_path / "agent")
    env = PushEnv(1, pushed_object="small_cube")
    for found in episodes(collect_demonstrations(config, progress=False)):
        assert len(found) > 5
        seen = replay_demonstration(found, env)
        np.testing.assert_array_equal(seen["physics"].numpy(), found.physics)
    env.close()


def test_minaris_environment_replays_an_episode_to_the_last_bit(collected) -> None:
    found = dataset(collected)
    assert found.total_episodes == 6
    env = found.recover_environment()
    assert env.observation_space == found.observation_space
    known = list(found.storage.get_episode_metadata(range(6)))
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


def test_images_are_in_the_infos(collected) -> None:
    stored = episodes(collected)[-1]
    images = dataset(collected)[1].infos["depth"]
    assert images.shape == (len(dataset(collected)[1]) + 1, 256, 256)
    with h5py.File(collected / "minari/modpush/push-v0/data/main_data.hdf5") as file:
        assert file["episode_1/infos/depth"].compression == "gzip"
    assert stored.segmentation is not None
    assert set(np.unique(stored.segmentation)) <= {0, 1, 2}


def test_a_run_goes_on_where_it_was_killed_and_takes_more(collected, tmp_path) -> None:
    folder = tmp_path / "run"
    shutil.copytree(collected, folder)
    lines = (folder / "attempts.csv").read_text().splitlines(keepends=True)
    cut = "".join(lines[:-1]) + lines[-1][:20]  # killed while it wrote the last row
    (folder / "attempts.csv").write_text(cut)
    shutil.rmtree(folder / "minari")
    before = {path: path.stat().st_mtime_ns for path in folder.glob("episodes/*/*.npz")}
    collect_demonstrations(replace(CONFIG, out=folder), progress=False)
    assert (folder / "attempts.csv").read_text().splitlines() == [line.strip() for line in lines]
    after = {path: path.stat().st_mtime_ns for path in folder.glob("episodes/*/*.npz")}
    assert sum(after[path] != before[path] for path in before) == 1
    for old, new in zip(episodes(collected), episodes(folder), strict=True):
        np.testing.assert_array_equal(old.physics, new.physics)

    more = replace(CONFIG, out=folder, episodes=4, policy=("scripted",))
    with pytest.warns(
        UserWarning, match=r"hold only the policies \['scripted'\]; also name \['corridor'\]"
    ):
        collect_demonstrations(more, progress=False)
    assert dataset(folder).total_episodes == 4


def test_a_hole_is_filled_where_more_is_there_than_asked_for(
    collected, tmp_path, monkeypatch
) -> None:
    folder = tmp_path / "run"
    shutil.copytree(collected, folder)
    lines = (folder / "attempts.csv").read_text().splitlines(keepends=True)
    (folder / "attempts.csv").write_text("".join([*lines[:2], *lines[3:]]))  # without number 1
    monkeypatch.setattr(collecting, "_TRIES", -20)  # as if many had been tried
    collect_demonstrations(replace(CONFIG, out=folder, episodes=1), progress=False)
    assert sorted((folder / "attempts.csv").read_text().splitlines(keepends=True)) == sorted(lines)
    assert dataset(folder).total_episodes == 2


def test_spl_is_by_the_map_that_the_starts_are_drawn_with(tmp_path) -> None:
    env = replace(
        ENV,
        difficulty=(1.0, 1.0),
        scene="diagonal_walls",
        inflation="inscribed",
        max_episode_steps=5,
    )
    config = CollectConfig(policy=("scripted",), episodes=2, env=env, out=tmp_path / "run")
    collect_demonstrations(config, progress=False)
    rows = pd.read_csv(config.out / "attempts.csv", index_col="number")
    differs = []
    for number in range(2):
        start = _start(config, number)
        expected = shortest_path(start, inflation="inscribed")[1]
        assert rows.loc[number, "shortest_length"] == pytest.approx(expected)
        differs.append(abs(shortest_path(start)[1] - expected) > 0.01)
    assert any(differs)


def test_another_run_s_folder_is_refused_before_anything_is_run(collected, tmp_path) -> None:
    other = replace(CONFIG, out=collected, env=ENV.with_fields(difficulty=(0.0, 0.5)))
    with pytest.raises(
        ValueError, match=r"holds other demonstrations, \(there, asked for\): .*env"
    ):
        collect_demonstrations(other, progress=False)
    with pytest.raises(ValueError, match="no 'nobody', expected agent, corridor"):
        collect_demonstrations(CollectConfig(policy=("nobody",), out=tmp_path), progress=False)
    assert not any(tmp_path.iterdir())


def test_only_success_keeps_what_reached_the_goal(tmp_path) -> None:
    config = replace(
        CONFIG,
        policy=("scripted",),
        episodes=2,
        only_success=True,
        images=False,
        env=ENV.with_fields(max_episode_steps=27),
        formats=("maniskill",),
        out=tmp_path,
    )
    collect_demonstrations(config, progress=False)
    assert all(found.success and found.depth is None for found in episodes(tmp_path))
    assert len(episodes(tmp_path)) >= 2
    assert not (tmp_path / "minari").exists()
    rows = pd.read_csv(tmp_path / "attempts.csv")
    assert (rows["kept"] == rows["success"]).all()
    hopeless = replace(
        config, episodes=1, env=ENV.with_fields(max_episode_steps=1), out=tmp_path / "none"
    )
    with pytest.raises(ValueError, match=r"'scripted' reached the goal in 0 of \d+ episodes"):
        collect_demonstrations(hopeless, progress=False)


def test_the_card_says_what_was_collected(collected) -> None:
    text = (collected / "README.md").read_text()
    assert "license: mit" in text
    assert "6 episodes" in text
    assert "| scripted | ScriptedPusher |" in text
    assert str(episode_seed(0, 0)) in text


def test_no_start_is_drawn_as_one_of_an_evaluation_set() -> None:
    seeds = [episode_seed(seed, number) for seed in (0, 3000) for number in (0, 999_999)]
    assert min(seeds) > 20_221_023  # held out in training; the sets' own are smaller
    assert max(seeds) < 2**32  # one word: two of them could be a set's and an episode's number
    states = {np.random.SeedSequence(seed).generate_state(1)[0] for seed in seeds}
    for name in SET_NAMES:
        assert len(load_set(name)) < min(seeds)
    assert len(states) == len(seeds)


def test_settings_are_checked() -> None:
    with pytest.raises(ValueError, match="has no flat observation"):
        CollectConfig(env=ENV.with_fields(encoder="end_to_end"))
    with pytest.raises(ValueError, match="a policy is named twice"):
        CollectConfig(policy=("agent", "agent"))
    with pytest.raises(ValueError, match="name must"):
        CollectConfig(name="a/b")


def test_actions_are_turned_and_kept_in_their_box(collected) -> None:
    for found in episodes(collected):
        assert np.abs(found.action).max() <= 1
        # The direction is turned, the yaw increment is not.
        np.testing.assert_array_equal(found.action[:, 2], found.command[:, 2])
        lengths = [np.linalg.norm(a[:, :2], axis=1) for a in (found.action, found.command)]
        np.testing.assert_allclose(*lengths, atol=1e-6)


def test_gymnasium_makes_the_environment_of_a_spec_with_the_whole_config(collected) -> None:
    spec = dataset(collected).env_spec
    assert spec.id == "modpush/Push-v0"
    assert gymnasium.envs.registration.EnvSpec.from_json(spec.to_json()).kwargs == spec.kwargs
    assert spec.kwargs["config"]["reward"]["weights"] == ENV.reward.weights


@pytest.mark.parametrize("changes", [{}, {"inflation": "inscribed", "scene": ("diagonal_walls",)}])
def test_starts_are_those_that_the_environment_draws(changes) -> None:
    config = CollectConfig(env=PushEnvConfig.preset("cpu", num_envs=1, encoder="none", **changes))
    env = gymnasium.make("modpush/Push-v0", **config.env_options())
    for number in range(3):
        env.reset(seed=episode_seed(config.seed, number))
        assert env.unwrapped.env.base_env.scenarios[0] == _start(config, number)
    env.close()
