"""Entries, reward and curriculum for goal poses, by hand and by moving the whole scene."""

import json
import math

import pytest
import torch
from tensordict import TensorDict
from torchrl.envs import Compose, TransformedEnv

from modpush.envs import PushEnv
from modpush.geometry.frames import rotate
from modpush.mdp import (
    Curriculum,
    CurriculumConfig,
    CurriculumScenes,
    PushObservation,
    PushReward,
    RewardConfig,
    RewardKeys,
)
from modpush.mdp.push_observation import MirroredObservation
from modpush.mdp.step_outcome import pose_length

ENTRIES = ("goal_distance_fine", "goal_axis", "yaw_error", "object_axis")


def state(object_pose, goal_pose, subgoal, symmetry=2.0):
    """What the entries read, with the yaw error of an object with two sides alike."""
    object_pose, goal_pose = torch.tensor([object_pose]), torch.tensor([goal_pose])
    period = 2 * math.pi / symmetry
    turn = (goal_pose - object_pose)[:, 2:]
    turn = torch.remainder(turn + period / 2, period) - period / 2
    distance = (goal_pose - object_pose)[:, :2].norm(dim=-1, keepdim=True)
    values = {
        "object_pose": object_pose,
        "goal_pose": goal_pose,
        "goal_position": goal_pose[:, :2],
        "pose_error": torch.cat([distance, turn], -1),
        "object_symmetry": torch.tensor([[symmetry]]),
        "subgoal": torch.tensor([subgoal]),
    }
    return TensorDict(values, [1])


def observed(td, kind=PushObservation):
    key = "observation" if kind is PushObservation else "mirrored_observation"
    return kind("path", entries=ENTRIES)(td)[key][0].tolist()


def test_entries_by_hand():
    # 4 cm ahead along x, to be turned by 30 degrees from 20 to 50.
    values = observed(
        state((0.5, 0.0, math.radians(20)), (0.54, 0.0, math.radians(50)), (0.54, 0.0))
    )
    expected = [math.tanh(1.0)]
    expected += [math.cos(math.radians(100)), math.sin(math.radians(100))]
    expected += [math.cos(math.radians(60)), math.sin(math.radians(60))]
    expected += [math.cos(math.radians(40)), math.sin(math.radians(40))]
    assert values == pytest.approx(expected, abs=1e-5)


def test_entries_do_not_change_with_the_whole_scene_turned_and_moved():
    start, goal, subgoal = (0.1, 0.2, 0.3), (0.25, 0.1, 1.9), (0.2, 0.12)
    before = observed(state(start, goal, subgoal))
    for angle in (0.7, 2.5, -1.9):

        def moved(pose, angle=angle):
            x, y = rotate(torch.tensor([pose[:2]]), torch.tensor([[angle]]))[0].tolist()
            return (x + 0.3, y - 0.2, *(yaw + angle for yaw in pose[2:]))

        assert observed(state(moved(start), moved(goal), moved(subgoal))) == pytest.approx(
            before, abs=1e-4
        )


def test_mirrored_entries_are_those_of_the_mirrored_scene():
    start, goal, subgoal = (0.1, 0.2, 0.3), (0.25, 0.1, 1.9), (0.2, 0.12)

    def mirrored(pose):
        return (pose[0], -pose[1], *(-yaw for yaw in pose[2:]))

    there = observed(state(mirrored(start), mirrored(goal), mirrored(subgoal)))
    assert observed(state(start, goal, subgoal), MirroredObservation) == pytest.approx(
        there, abs=1e-5
    )


def test_a_disc_shows_no_yaw():
    td = state((0.5, 0.0, 0.3), (0.6, 0.0, 2.0), (0.6, 0.0))
    td["object_symmetry"].zero_()
    td["pose_error"][:, 1] = 0.0
    assert observed(td)[1:] == pytest.approx([1, 0, 1, 0, 1, 0])


def test_the_way_to_a_pose_by_hand():
    # 3 cm along the path; a point 4 cm out moves by 2 * 4 cm * sin(30 degrees) = 4 cm.
    length = pose_length(*(torch.tensor([[x]]) for x in (0.03, math.radians(60), 0.04)))
    assert length.item() == pytest.approx(0.05, abs=1e-6)


def step(path, turn, radius=0.04):
    flags = ("object_contact", "obstacle_contact", "tool_obstacle_contact", "success")
    values = {name: torch.tensor([[False]]) for name in (*flags, "out_of_bounds")}
    values |= {"path_length": torch.tensor([[path]]), "object_radius": torch.tensor([[radius]])}
    values |= {"object_pose": torch.zeros(1, 3), "ee_pose": torch.zeros(1, 3)}
    return TensorDict({**values, "mine": {"pose_error": torch.tensor([[path, turn]])}}, [1])


@pytest.mark.parametrize(
    ("before", "after", "expected"),
    [
        ((0.20, 0.0), (0.18, 0.0), 0.02),
        ((0.05, 0.0), (0.03, 0.0), 0.02 + 2 * 0.01),  # the last 4 cm count three times
        ((0.03, 0.0), (0.05, 0.0), -0.04),
        ((0.0, math.radians(60)), (0.0, 0.0), 3 * 0.04),
    ],
)
def test_progress_towards_a_pose_by_hand(before, after, expected):
    keys = RewardKeys(pose_error=("mine", "pose_error"))
    reward = PushReward(RewardConfig(weights={"pose_progress": 10.0}, scale=0.5), keys=keys)
    td = step(*before).set("reward_start", torch.ones(1, 2))
    td = reward(td.set("action", torch.zeros(1, 3)).set("next", step(*after)))
    assert td["next", "reward"].item() == pytest.approx(5 * expected, abs=1e-6)


def test_without_goal_poses_the_reward_needs_none():
    td = step(0.3, 0.0).exclude("mine", "object_radius").set("reward_start", torch.ones(1, 2))
    td.set("action", torch.zeros(1, 3)).set("next", step(0.2, 0.0).exclude("mine"))
    assert PushReward()(td)["next", "reward"].isfinite().all()


def narrowing(**changes):
    config = {"promotion": "off", "yaw_tolerances": (1.5, 0.5, 0.2), "threshold": 0.5, "window": 4}
    return Curriculum(CurriculumConfig(**{**config, **changes}))


def record(curriculum, *outcomes):
    for outcome in outcomes:
        curriculum.record(outcome, "free")


def test_yaw_tolerances_narrow_as_episodes_succeed():
    curriculum = narrowing()
    first = curriculum.level
    record(curriculum, True, True, True)
    assert (curriculum.yaw_tolerance, curriculum.level) == (1.5, first)
    record(curriculum, False)
    assert (curriculum.yaw_tolerance, curriculum.level) == (0.5, first + 1)
    record(curriculum, False, False, False, True, False, True)  # 2 of the last 4 at the end
    assert curriculum.yaw_tolerance == 0.2
    record(curriculum, *[True] * 8)
    assert (curriculum.yaw_tolerance, curriculum.level) == (0.2, first + 2)
    restored = narrowing()
    restored.load_state_dict(json.loads(json.dumps(curriculum.state_dict())))
    assert restored.state_dict() == curriculum.state_dict()
    assert restored.yaw_tolerance == 0.2


def test_distances_come_before_yaw_tolerances():
    curriculum = narrowing(promotion="success", distances=(0.06, 0.6))
    record(curriculum, *[True] * 4)
    assert (curriculum.stage, curriculum.yaw_tolerance) == (1, 1.5)
    record(curriculum, *[True] * 4)
    assert (curriculum.stage, curriculum.yaw_tolerance) == (1, 0.5)


def test_the_environment_gets_the_yaw_tolerance():
    curriculum = narrowing()
    base = PushEnv(2, goal="pose", depth=None, pushed_object="box", position_tolerance=0.015)
    env = TransformedEnv(base, Compose(CurriculumScenes(curriculum)))
    env.reset()
    assert base.yaw_tolerance == 1.5
    record(curriculum, *[True] * 4)
    env.reset()
    assert base.yaw_tolerance == 0.5
    env.close()
