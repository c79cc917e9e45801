"""Hindsight goals: what is stored is what the same course would have given with the other goal."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
import torch
from tensordict import TensorDict
from torchrl.envs.utils import step_mdp

from modpush.envs import SENSING, PushEnv
from modpush.envs.engines.base import CONTACT_KEYS
from modpush.envs.engines.recorded import RecordedEngine, Recording
from modpush.mdp import CurriculumConfig
from modpush.recipes import make_push_env
from modpush.replay import NStepTransform
from modpush.training import TRAIN_PRESETS, Trainer
from modpush.training.hindsight import Hindsight, n_step_returns

POSE = TRAIN_PRESETS["pose"]
SMALL = replace(
    POSE,
    env=POSE.env.with_fields(num_envs=2, max_episode_steps=12, scene=("free", "posts")),
    greedy_envs=0,
)
KEYS = [
    "observation",
    "mirrored_observation",
    "action",
    ("next", "reward"),
    ("next", "observation"),
]
KEYS += [("next", "mirrored_observation"), ("next", "done"), ("next", "terminated")]
TURNED = np.pi / 2  # any yaw of the box is good


def episodes(env, steps):
    """Steps towards the object until all episodes have ended, as the environment returns them."""
    td, taken = env.reset(), []
    for _ in range(steps):
        towards = (td["object_pose"] - td["ee_pose"])[:, :2]
        yaw = torch.atan2(*(td["subgoal"] - td["object_pose"][:, :2]).flip(-1).unbind(-1))
        angle = torch.atan2(towards[:, 1], towards[:, 0]) - yaw
        action = torch.stack([angle.cos(), angle.sin(), torch.full((2,), 0.3)], -1)
        td = env.step(td.set("action", action))
        taken.append(td)
        td = step_mdp(td)
    return taken


@pytest.fixture(scope="module")
def recorded():
    """A dozen steps of two scenes; the second object has left the workspace at the end."""
    env = make_push_env(replace(SMALL.env, recovery=False), mirrored=True, seed=5)
    steps = episodes(env, 12)
    scenarios = env.scenarios
    hindsight = Hindsight(SMALL, {}, make_push_env, KEYS)
    for step in steps[:-1]:
        hindsight.add(step, scenarios, TURNED)
        assert not hindsight._waiting
    hindsight.add(steps[-1], scenarios, TURNED)
    yield steps, scenarios, hindsight
    hindsight.close()
    env.close()


def test_a_recorded_episode_looks_as_it_did(recorded) -> None:
    """Played again with its own goal, nothing that the agent sees or gets has changed."""
    steps, scenarios, hindsight = recorded
    same = [replace(e, scenario=s) for e, s in zip(hindsight._waiting, scenarios, strict=True)]
    plain = replace(SMALL, replay=replace(SMALL.replay, n_steps=1))
    again = Hindsight(plain, {}, make_push_env, KEYS)
    played = again._play(same)
    again.close()
    before = TensorDict.stack(steps, 1).select(*KEYS)
    assert len(played[0]) == 12
    for row, rest in zip(before, played, strict=True):
        for key in KEYS:
            torch.testing.assert_close(row[key][: len(rest)], rest[key], atol=1e-5, rtol=1e-5)


def test_an_episode_is_played_again_with_its_own_noise_and_delays() -> None:
    """Axes of the actions are those that were observed, and the same start gives the same noise."""
    env = SMALL.env.with_fields(sensing=SENSING["noise_delay"], recovery=False)
    config = replace(SMALL, env=env, replay=replace(SMALL.replay, n_steps=1))
    recorded = make_push_env(env, mirrored=True, seed=5)
    steps, scenarios = episodes(recorded, 12), recorded.scenarios
    hindsight = Hindsight(config, {}, make_push_env, KEYS)
    for step in steps:
        hindsight.add(step, scenarios, 0.0)  # a yaw that no episode meets from the start
    waiting = zip(hindsight._waiting, scenarios, strict=True)
    played = hindsight._play([replace(episode, scenario=start) for episode, start in waiting])
    before = TensorDict.stack(steps, 1).select(*KEYS)
    for row, rest in zip(before, played, strict=True):
        for key in KEYS:
            torch.testing.assert_close(row[key][: len(rest)], rest[key], atol=1e-5, rtol=1e-5)
    recorded.close()
    hindsight.close()


def test_with_its_last_pose_as_the_goal_an_episode_succeeds(recorded) -> None:
    steps, _, hindsight = recorded
    waiting = list(hindsight._waiting)
    x, y, yaw = steps[-1]["next", "object_pose"][0].tolist()
    assert waiting[0].scenario.goal_position == (x, y)
    assert waiting[0].scenario.goal_yaw == yaw
    assert len(waiting[0].actions) == 12 > len(waiting[1].actions)
    longer, shorter = waiting
    hindsight._waiting = [longer, shorter] * 4 + [longer]
    found = hindsight.transitions(TURNED)
    assert hindsight._waiting == [longer], "an odd one waits for another"
    hindsight._waiting = waiting
    ends = np.flatnonzero(found["next", "terminated"])
    assert len(ends) == 8 * 3  # with three-step returns the last three transitions end in the goal
    assert found["next", "reward"].max() > 4.0  # that of the goal, 50 times 0.1
    assert set(found) == {*KEYS, "steps_to_next_obs"}
    assert len({len(values) for values in found.values()}) == 1


def test_episodes_of_like_length_are_played_together(recorded, monkeypatch) -> None:
    """A group takes as many steps as its longest episode."""
    _, _, hindsight = recorded
    longer, shorter = hindsight._waiting
    groups = []
    monkeypatch.setattr(hindsight, "_play", lambda group: groups.append(group) or play(group))
    play = partial(Hindsight._play, hindsight)
    hindsight._waiting = [longer, shorter] * 3 + [longer]
    assert hindsight.transitions(TURNED) == {}
    hindsight._waiting.append(shorter)
    assert hindsight.transitions(TURNED)
    assert groups == [[shorter, shorter]] * 2 + [[longer, longer]] * 2
    hindsight._waiting = [longer, shorter]


def test_episodes_that_teach_nothing_are_dropped() -> None:
    hindsight = Hindsight(SMALL, {}, make_push_env, KEYS)
    env = make_push_env(replace(SMALL.env, recovery=False), mirrored=True, seed=4)
    td = env.reset()
    for _ in range(12):  # the tool stands still, and so does the object
        td = env.step(td.set("action", torch.zeros(2, 3)))
        hindsight.add(td, env.scenarios, TURNED)
        td = step_mdp(td)
    assert hindsight._waiting == []
    assert hindsight._steps == [[], []]
    env.close()
    hindsight.close()


def test_an_object_that_left_the_workspace_ends_where_it_was_inside(recorded) -> None:
    _, scenarios, hindsight = recorded
    rows = np.zeros((4, 2 * 18 + 3), dtype=np.float32)
    where = np.array([[0.3, 0.0], [0.3, 0.1], [0.3, 0.2], [0.3, 0.34], [0.3, 0.41]])
    rows[:, :2], rows[:, 18:20] = where[:-1], where[1:]
    episode = hindsight._relabelled(rows, scenarios[0], TURNED)
    assert episode.scenario.goal_position == pytest.approx((0.3, 0.34))
    assert len(episode.recording) == len(episode.actions) == 3
    rows[:, :2], rows[:, 18:20] = 0.9, 0.9  # never inside
    assert hindsight._relabelled(rows, scenarios[0], TURNED) is None


@pytest.mark.parametrize("n_steps", [1, 2, 3, 8])
def test_n_step_returns_are_those_of_the_transform(n_steps) -> None:
    torch.manual_seed(0)
    last = torch.arange(6)[:, None] == 5
    after = {"observation": torch.randn(6, 2), "reward": torch.randn(6, 1), "done": last}
    episode = TensorDict(
        {"observation": torch.randn(6, 2), "next": {**after, "terminated": last.clone()}}, [6]
    )
    found = n_step_returns(episode, n_steps, 0.9)
    if n_steps == 1:
        assert found is episode
        return
    transform = NStepTransform(n_steps, 0.9)
    padding = episode.clone().apply(torch.zeros_like)  # lets the last steps go
    given = [transform.inv(td[None]) for td in (episode, padding, padding)]
    wanted = torch.cat([td for td in given if td is not None])[:6]
    for key in wanted.keys(True, True):
        torch.testing.assert_close(found[key], wanted[key])


def test_a_run_learns_from_them_and_resumes_to_the_last_bit(tmp_path) -> None:
    tolerances = (1.5, POSE.env.simulation.yaw_tolerance)
    short = replace(
        SMALL,
        tqc=replace(SMALL.tqc, hidden_sizes=(16,), batch_size=16, learning_starts=320),
        replay=replace(SMALL.replay, batch_size=16, capacity=10_000),
        curriculum=CurriculumConfig(promotion="off", yaw_tolerances=tolerances, window=4),
        total_steps=768,
        evaluate_every=768,
        evaluation_episodes=2,
        checkpoint_every=384,
        log_every=48,
        async_collection=False,
        progress=False,
    )
    trainer = Trainer(short, tmp_path / "whole")
    trainer.run()
    stored = len(trainer.learner.buffer)
    assert stored > 768  # more than were taken
    half = replace(short, total_steps=384)
    Trainer(half, tmp_path / "parts").run()
    resumed = Trainer(short, tmp_path / "parts", resume=True)
    resumed.run()
    assert len(resumed.learner.buffer) == stored
    for name, value in trainer.learner.actor_weights().items():
        np.testing.assert_array_equal(value, resumed.learner.actor_weights()[name])


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"arm_in_depth": True}, "hindsight needs env.simulation.arm_in_depth=False.*got True"),
        ({"dynamic_obstacles": True}, "hindsight needs env.simulation.dynamic_obstacles=False"),
        ({"depth": "sapien"}, "hindsight needs env.simulation.depth='analytic'.*got 'sapien'"),
        ({"yaw_tolerance": 0.3}, "yaw_tolerances must end with .* got 0.1745 rad, 0.3 rad"),
        ({"goal": "position"}, "yaw_tolerances must end with .*goal='position'"),
    ],
)
def test_what_does_not_fit_is_refused(changes, message) -> None:
    with pytest.raises(ValueError, match=message):
        replace(POSE, env=POSE.env.with_fields(**changes))


def test_a_recording_is_needed_and_says_what_it_lacks() -> None:
    engines = []

    def make(spec):
        engines.append(RecordedEngine(spec))
        return engines[-1]

    env = PushEnv(1, engine=make, sim_freq=15, pushed_object="box", seed=0)
    with pytest.raises(ValueError, match="assign a recording before the reset, got None"):
        env.reset()
    engines[0].recording = Recording(
        object_pose=np.array([[0.4, 0.0, 0.1], [0.41, 0.0, 0.1]], dtype=np.float32),
        ee_pose=np.array([[0.3, 0.0, 0.0], [0.31, 0.0, 0.0]], dtype=np.float32),
        joint_position=np.zeros((2, 6), dtype=np.float32),
        contacts=np.ones((1, len(CONTACT_KEYS)), dtype=bool),
    )
    td = env.reset()
    assert not td["object_contact"].item()
    for _ in range(2):  # after its end it stays
        td = env.step(td.set("action", torch.zeros(1, 3)))["next"]
        assert td["object_pose"][0].tolist() == pytest.approx([0.41, 0.0, 0.1])
    assert not td["object_contact"].item()
    state = env.get_state()
    env.reset()
    assert env.set_state(state)["object_pose"][0, 0] == pytest.approx(0.41)
    with pytest.raises(ValueError, match=r"names must be \['tip'\].*got \['tool'\]"):
        engines[0].link_transforms(["tool"])
    with pytest.raises(ValueError, match=r"expected a step in \[0, 1\]"):
        engines[0].check_packed(np.array([5.0], dtype=np.float32), env.scenarios[0])
    assert set(engines[0].gaps().values()) == {float("inf")}
    env.close()
