"""An environment's episodes drawn from a curriculum."""

import pytest
import torch
from tensordict import TensorDict
from torchrl.envs import TransformedEnv

from modpush.envs import PushEnv, ScenarioConfig
from modpush.mdp import Curriculum, CurriculumConfig, CurriculumScenes, Phase

SHORT = CurriculumConfig(
    distances=(0.06, 0.1, 0.2),
    phases=(Phase(scenes=("free",)), Phase(first_stage=1)),
    window=4,
    threshold=0.75,
)


def solve(curriculum, *outcomes):
    for outcome in outcomes:
        curriculum.record(outcome, "free")


def distance_of(td):
    return (td["goal_position"] - td["object_pose"][:, :2]).norm(dim=-1)


def test_an_environment_draws_from_the_stage_and_its_state_has_it():
    curriculum = Curriculum(SHORT)
    transform = CurriculumScenes(curriculum, evaluated_envs=[1])
    env = TransformedEnv(PushEnv(2, depth=None, max_episode_steps=2, seed=0), transform)
    td = env.reset()
    torch.testing.assert_close(distance_of(td), torch.full((2,), 0.06), atol=1e-4, rtol=0)
    solve(curriculum, *[True] * 4)
    solve(curriculum, *[True] * 4)
    td["_reset"] = torch.tensor([[True], [False]])
    td = env.reset(td)
    assert 0.06 <= distance_of(td)[0] <= 0.6
    assert distance_of(td)[1] == pytest.approx(0.06, abs=1e-4)
    assert td["curriculum_level"][0].item() == 2
    other = TransformedEnv(PushEnv(2, depth=None, seed=0), CurriculumScenes(Curriculum(SHORT)))
    other.load_state_dict(env.state_dict())
    assert other.transform.curriculum.stage == 2
    env.close()
    other.close()


def test_only_evaluated_scenes_that_began_at_this_stage_count():
    curriculum = Curriculum(SHORT)
    env = TransformedEnv(
        PushEnv(2, depth=None, max_episode_steps=3, seed=0),
        CurriculumScenes(curriculum, evaluated_envs=[1]),
    )
    td = env.reset()

    def run(td):
        for _ in range(3):
            action = torch.zeros(2, 3)
            td, following = env.step_and_maybe_reset(td.set("action", action))
            td = following
        return td

    td = run(td)
    assert curriculum.state_dict()["successes"] == [False]
    curriculum.stage = 1  # goes on while episodes are under way
    td = run(td)
    assert curriculum.state_dict()["successes"] == [False]  # they began before
    run(td)
    assert curriculum.state_dict()["successes"] == [False, False]
    assert curriculum.steps == 9 * 2
    env.close()


def test_each_scene_is_told_of_by_itself():
    curriculum = Curriculum(SHORT)
    transform = CurriculumScenes(curriculum)
    env = TransformedEnv(PushEnv(2, depth=None, seed=0), transform)
    td = env.reset()
    curriculum.stage = 1
    td["_reset"] = torch.tensor([[True], [False]])
    td = env.reset(td)
    flags = {"success": torch.tensor([[False], [True]]), "done": torch.ones(2, 1, dtype=torch.bool)}
    transform._step(td, TensorDict(flags, [2]))
    # The second scene's episode began before the stage, although the other scene was reset since.
    assert curriculum.state_dict()["successes"] == [False]
    transform._step(env.reset(), TensorDict(flags, [2]))
    assert curriculum.state_dict()["successes"] == [False, False, True]
    env.close()


def test_a_scenario_that_is_set_between_resets_is_respected():
    curriculum = Curriculum(SHORT)
    curriculum.phase, curriculum.stage = 1, 2
    env = TransformedEnv(PushEnv(1, depth=None, scene="free", seed=0), CurriculumScenes(curriculum))
    env.reset()
    assert env.base_env.scenarios[0].scene == "free"
    env.base_env.scenario = ScenarioConfig(scene="posts", clearance=0.08)
    for _ in range(2):
        env.reset()
        assert env.base_env.scenarios[0].scene == "posts"
        assert env.base_env.scenario.clearance == 0.08
        assert env.base_env.scenario.distance == (0.2, 0.6)  # still the curriculum's
    env.close()


def test_a_phase_draws_scenes_of_your_own():
    config = CurriculumConfig(phases=(Phase(scenes=("tests.mdp.own_parts:meadow",)),))
    curriculum = Curriculum(config)
    env = TransformedEnv(
        PushEnv(1, depth=None, max_episode_steps=1, seed=0), CurriculumScenes(curriculum)
    )
    env.step(env.reset().set("action", torch.zeros(1, 3)))
    assert curriculum.scene_success_rates == {"tests.mdp.own_parts:meadow": 0.0}
    env.close()


def test_nested_keys():
    curriculum = Curriculum(SHORT)
    transform = CurriculumScenes(
        curriculum,
        success_key=("task", "success"),
        done_key=("task", "done"),
        level_key=("task", "level"),
    )
    env = TransformedEnv(PushEnv(2, depth=None, seed=0), transform)
    td = env.reset()
    assert td["task", "level"].tolist() == [[0.0], [0.0]]
    flags = TensorDict({"success": [[True], [False]], "done": [[True], [False]]}, [2])
    after = transform._step(td, TensorDict({"task": flags}, [2]))
    assert curriculum.state_dict()["successes"] == [True]
    assert after["task", "level"].tolist() == [[0.0], [0.0]]
    with pytest.raises(KeyError, match=r"key .*task.*done.* is missing"):
        transform._step(td, TensorDict({}, [2]))
    env.close()


def test_episodes_of_the_warm_up_are_of_all_distances_and_do_not_count():
    curriculum = Curriculum(SHORT, warm_up=16)
    env = TransformedEnv(
        PushEnv(4, depth=None, max_episode_steps=3, seed=0), CurriculumScenes(curriculum)
    )
    td = env.reset()
    assert distance_of(td).min() >= 0.2
    for step in range(9):
        td["action"] = torch.zeros(4, 3)
        td, following = env.step_and_maybe_reset(td)
        # The second episodes begin after 12 of the 16 steps, and end after it.
        assert curriculum.warming_up == (4 * (step + 1) < 16)
        assert len(curriculum.scene_success_rates) == (step == 8)
        td = following
    torch.testing.assert_close(distance_of(td), torch.full((4,), 0.06), atol=1e-4, rtol=0)


def test_an_episode_counts_once_however_late_its_scene_is_reset():
    curriculum = Curriculum(SHORT)
    env = TransformedEnv(
        PushEnv(2, depth=None, max_episode_steps=3, seed=0), CurriculumScenes(curriculum)
    )
    td = env.reset()
    for _ in range(6):  # both episodes are over after three
        td = env.step(td.set("action", torch.zeros(2, 3)))["next"]
    assert curriculum.state_dict()["successes"] == [False, False]
    before = curriculum.steps
    td.set("_step", torch.tensor([True, False]))  # as TorchRL's rollouts leave out what is done
    env.step(td.set("action", torch.zeros(2, 3)))
    assert curriculum.steps == before + 1
    env.close()
