"""Trajectories in ManiSkill's format, read and replayed by ManiSkill's own tools."""

import json

import gymnasium as gym
import h5py
import numpy as np
import pytest
import torch
from mani_skill.trajectory import replay_trajectory, utils as trajectory_utils
from mani_skill.trajectory.dataset import ManiSkillTrajectoryDataset
from mani_skill.utils.wrappers import RecordEpisode

from modpush.data import Demonstration

# ManiSkill asks git which commit it is of, and says so where it is not in a repository.
pytestmark = pytest.mark.filterwarnings("ignore:The 'warn' method is deprecated")


def contents(group: h5py.Group) -> dict[str, tuple[tuple[int, ...], np.dtype]]:
    found = {}
    group.visititems(
        lambda name, item: (
            found.update({name: (item.shape[1:], item.dtype)})
            if isinstance(item, h5py.Dataset)
            else None
        )
    )
    return found


@pytest.fixture(scope="module")
def recorded(collected, tmp_path_factory):
    """What ManiSkill's own recorder writes of the first episode, done again through ManiSkill."""
    folder = tmp_path_factory.mktemp("maniskill")
    about = json.loads((collected / "trajectory.json").read_text())
    info, first = about["env_info"], about["episodes"][0]
    env = gym.make(info["env_id"], **info["env_kwargs"])
    env = RecordEpisode(env, str(folder), trajectory_name="own", save_video=False)
    env.reset(**first["reset_kwargs"])
    with h5py.File(collected / "trajectory.h5") as file:
        for action in file["traj_0/actions"][:]:
            env.step(action)
    env.close()
    return folder / "own.h5"


def test_the_content_is_that_of_maniskills_recorder(collected, recorded) -> None:
    with h5py.File(collected / "trajectory.h5") as ours, h5py.File(recorded) as theirs:
        assert contents(ours["traj_0"]) == contents(theirs["traj_0"])
        state, own = ours["traj_0/env_states"], theirs["traj_0/env_states"]
        for name in contents(state):
            np.testing.assert_allclose(state[name][0], own[name][0], atol=1e-6, err_msg=name)
        # ManiSkill's controller rounds otherwise, and contacts amplify it.
        ours_at, theirs_at = (s["actors/small_cube"][:, :2] for s in (state, own))
        np.testing.assert_allclose(ours_at, theirs_at, atol=0.01)
        for name in contents(ours["traj_0/obs"]):
            np.testing.assert_allclose(
                ours["traj_0/obs"][name][0], theirs["traj_0/obs"][name][0], atol=1e-6, err_msg=name
            )


def test_the_json_file_is_that_of_maniskills_recorder(collected, recorded) -> None:
    ours = json.loads((collected / "trajectory.json").read_text())
    theirs = json.loads(recorded.with_suffix(".json").read_text())
    assert set(theirs["env_info"]) == set(ours["env_info"])
    assert set(theirs["episodes"][0]) <= set(ours["episodes"][0])
    assert theirs["episodes"][0]["episode_seed"] in (
        ours["episodes"][0]["episode_seed"],
        [ours["episodes"][0]["episode_seed"]],
    )
    assert [e["policy"] for e in ours["episodes"]] == ["scripted"] * 3 + ["corridor"] * 3


def test_maniskills_dataset_reads_it(collected) -> None:
    data = ManiSkillTrajectoryDataset(str(collected / "trajectory.h5"))
    count = sum(len(Demonstration.load(p)) for p in collected.glob("episodes/*/*.npz"))
    assert len(data) == count
    assert data[0]["obs"]["extra"]["object_pose"].shape == (3,)
    assert data[0]["action"].shape == (3,)


def test_maniskills_replay_tool_solves_the_episodes_again(collected, monkeypatch) -> None:
    # As its command line with `--use-env-states --render-mode none`, which makes no pictures.
    results: list[replay_trajectory.ReplayResult] = []
    original = replay_trajectory.replay_cpu_sim

    def counted(*args):
        results.append(original(*args))
        return results[-1]

    about = json.loads((collected / "trajectory.json").read_text())
    monkeypatch.setattr(replay_trajectory, "replay_cpu_sim", counted)
    args = replay_trajectory.Args(
        traj_path=str(collected / "trajectory.h5"), use_env_states=True, render_mode="none"
    )
    replay_trajectory.main(args)
    assert sum(result.num_replays for result in results) == 6
    solved = sum(e["success"] for e in about["episodes"])
    assert solved > 0
    assert sum(result.successful_replays for result in results) == solved


def test_every_state_can_be_set_in_the_task(collected) -> None:
    about = json.loads((collected / "trajectory.json").read_text())
    env = gym.make(about["env_info"]["env_id"], **about["env_info"]["env_kwargs"])
    env.reset(**about["episodes"][4]["reset_kwargs"])
    with h5py.File(collected / "trajectory.h5") as file:
        states = trajectory_utils.dict_to_list_of_dicts(file["traj_4/env_states"])
    for state in states[:: len(states) // 3]:
        env.unwrapped.set_state_dict(state)
        now = env.unwrapped.get_state_dict()
        for kind in ("actors", "articulations"):
            for name, value in state[kind].items():
                torch.testing.assert_close(
                    now[kind][name][0], torch.from_numpy(np.asarray(value)), rtol=0, atol=1e-6
                )
    env.close()
