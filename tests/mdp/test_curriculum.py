"""When the episodes get harder, and that they do."""

import json
from dataclasses import replace

import pytest

from modpush.envs import ScenarioConfig
from modpush.envs.scenes.layouts import OBSTACLE_SCENES
from modpush.mdp import Curriculum, CurriculumConfig, Phase

SHORT = CurriculumConfig(
    distances=(0.06, 0.1, 0.2),
    phases=(Phase(scenes=("free",)), Phase(scenes=("free", "posts"), first_stage=1)),
    window=4,
    threshold=0.75,
)


def solve(curriculum, *outcomes, **kwargs):
    for outcome in outcomes:
        curriculum.record(outcome, "free", **kwargs)


def test_distances_are_those_of_the_stage():
    curriculum = Curriculum()
    base = ScenarioConfig(pushed_object="fragment")
    assert curriculum.scenario(base).distance == (0.06, 0.06)
    curriculum.stage = 3
    assert curriculum.scenario(base).distance == (0.08, 0.18)
    curriculum.stage = 11
    assert curriculum.scenario(base).distance == (0.2, 0.6)
    assert curriculum.scenario(base).pushed_object == ("fragment",)


def test_difficulty_grows_to_the_whole_range():
    curriculum = Curriculum(SHORT)
    ranges = []
    for stage in range(3):
        curriculum.stage = stage
        ranges.append(curriculum.scenario(ScenarioConfig()).difficulty)
    assert ranges == [(0.0, pytest.approx(1 / 3)), (0.0, pytest.approx(2 / 3)), (0.0, 1.0)]


def test_continues_at_the_threshold_over_a_full_window():
    curriculum = Curriculum(SHORT)
    solve(curriculum, True, True, True)
    assert curriculum.stage == 0  # three of four are not a window yet
    solve(curriculum, False)
    assert curriculum.stage == 1  # 3/4 is the threshold
    solve(curriculum, True, True, False, False)
    assert curriculum.stage == 1
    solve(curriculum, True, True)  # the last four: F F T T
    assert curriculum.stage == 1
    solve(curriculum, True)
    assert curriculum.stage == 2


def test_episodes_that_are_not_evaluated_only_count_for_their_scene():
    curriculum = Curriculum(SHORT)
    solve(curriculum, *[True] * 10, evaluated=False)
    assert curriculum.stage == 0
    assert curriculum.scene_success_rates == {"free": 1.0}


def test_obstacles_come_after_free_space_and_begin_lower():
    curriculum = Curriculum(SHORT)
    levels = []
    for _ in range(7):
        levels.append((curriculum.level, curriculum.phase, curriculum.stage))
        solve(curriculum, *[True] * 4)
    assert levels[:5] == [(0, 0, 0), (1, 0, 1), (2, 0, 2), (3, 1, 1), (4, 1, 2)]
    assert levels[5:] == [levels[4]] * 2  # there is nothing after the last
    assert curriculum.finished
    assert curriculum.scenario(ScenarioConfig()).scene == ("free", "posts")


def test_it_begins_with_the_first_stage_of_the_first_phase():
    curriculum = Curriculum(replace(SHORT, phases=(Phase(first_stage=1), Phase())))
    assert (curriculum.phase, curriculum.stage, curriculum.level) == (0, 1, 0)
    assert curriculum.scenario(ScenarioConfig()).distance == (0.06, 0.1)
    solve(curriculum, *[True] * 8)
    assert (curriculum.phase, curriculum.stage, curriculum.level) == (1, 0, 2)


def test_episodes_of_the_warm_up_are_as_hard_as_the_last_ones():
    curriculum = Curriculum(SHORT, warm_up=10)
    scenario = curriculum.scenario(ScenarioConfig())
    assert (scenario.distance, scenario.difficulty) == ((0.2, 0.6), (0.0, 1.0))
    assert scenario.scene == ("free",)  # of the present phase
    curriculum.count_steps(10)
    scenario = curriculum.scenario(ScenarioConfig())
    assert (scenario.distance, scenario.difficulty[1]) == ((0.06, 0.06), pytest.approx(1 / 3))


@pytest.mark.parametrize("scene", ["slot", ("free", *OBSTACLE_SCENES)])
def test_after_free_space_come_the_environments_own_scenes(scene):
    phases = (Phase(scenes=("free",)), Phase(first_stage=6))
    curriculum = Curriculum(CurriculumConfig(phases=phases))
    base = ScenarioConfig(scene=scene)
    assert curriculum.scenario(base).scene == ("free",)
    curriculum.phase = 1
    assert curriculum.scenario(base).scene == base.scene


def test_state_survives_json_and_continues_alike():
    one = Curriculum(SHORT)
    solve(one, True, True, True, True, True, False)
    two = Curriculum(SHORT)
    two.load_state_dict(json.loads(json.dumps(one.state_dict())))
    for curriculum in (one, two):
        solve(curriculum, True, True)
    assert one.state_dict() == two.state_dict()
    assert two.stage == 2


def test_a_state_of_a_longer_curriculum_is_refused():
    state = {**Curriculum().state_dict(), "stage": 9}
    with pytest.raises(ValueError, match="in one of 2 phases, here of stages 0 to 2"):
        Curriculum(SHORT).load_state_dict(state)
    later = Curriculum(replace(SHORT, phases=(Phase(first_stage=1),)))
    with pytest.raises(ValueError, match="here of stages 1 to 2"):
        later.load_state_dict({**later.state_dict(), "stage": 0})
