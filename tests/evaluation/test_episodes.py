from dataclasses import replace
from functools import partial
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from tensordict import TensorDict, TensorDictBase
from tensordict.nn import TensorDictModule
from torchrl.envs import Compose, EnvBase, ExcludeTransform, TransformedEnv

from modpush.agents import ScriptedPusher
from modpush.envs import Obstacle, PushEnv, Scenario
from modpush.envs.scenes.sampling import sample_scenario
from modpush.evaluation.episodes import _Log, _record, _restart, run_episodes
from modpush.evaluation.sets import EvaluationSet, load_set
from modpush.planners import DistanceField, OccupancyGrid, PlannerSubgoals
from tests.evaluation.conftest import make_env


def test_every_episode_runs_once_and_as_it_was_given(env: EnvBase, free: EvaluationSet) -> None:
    numbered = list(enumerate(free.scenarios))[10:17]  # more than scenes, not a multiple of them
    episodes = list(run_episodes(env, ScriptedPusher(), numbered))
    assert sorted(e.number for e in episodes) == list(range(10, 17))
    for episode in episodes:
        scenario, trajectory = free.scenarios[episode.number], episode.trajectory
        assert episode.scenario == scenario
        np.testing.assert_allclose(trajectory.object_pose[0], scenario.object_pose, atol=2e-3)
        np.testing.assert_allclose(trajectory.ee_pose[0, :2], scenario.tool_pose[:2], atol=2e-3)
        assert len(trajectory.contacts) == episode.metrics.steps
        assert len(trajectory.object_pose) == episode.metrics.steps + 1
        distance = np.linalg.norm(trajectory.object_pose[-1, :2] - np.array(scenario.goal_position))
        assert episode.metrics.success == (distance <= 0.05)
        assert episode.metrics.final_distance == pytest.approx(distance, abs=1e-6)
    assert np.mean([e.metrics.success for e in episodes]) >= 0.8


def test_results_do_not_depend_on_the_number_of_scenes(env: EnvBase, free: EvaluationSet) -> None:
    numbered = list(enumerate(free.scenarios))[:6]
    one = make_env(1, ("small_cube",))
    results = [
        {e.number: e for e in run_episodes(some, ScriptedPusher(), numbered)} for some in (env, one)
    ]
    one.close()
    for number in range(6):
        first, second = (r[number] for r in results)
        assert first.metrics.success == second.metrics.success
        assert first.metrics.steps == second.metrics.steps
        np.testing.assert_allclose(
            first.trajectory.object_pose, second.trajectory.object_pose, atol=1e-4
        )


def begun(scenario: Scenario, inflation: str = "circumscribed") -> _Log:
    """The log of an episode that has just begun."""
    return _Log(0, scenario, TensorDict(poses_of(scenario), [1]), 0, inflation=inflation)


def poses_of(scenario: Scenario) -> dict[str, torch.Tensor]:
    """Where object and tool are at its start, of one scene."""
    poses = {"object_pose": scenario.object_pose, "ee_pose": scenario.tool_pose}
    return {name: torch.tensor([pose]) for name, pose in poses.items()}


def test_what_each_flag_of_a_step_counts_for(free: EvaluationSet) -> None:
    scenario = free.scenarios[0]
    on = {"obstacle_contact", "object_contact_at_end", "success", "done"}
    on |= {"tool_obstacle_contact_at_end"}
    off = {"object_contact", "tool_obstacle_contact", "out_of_bounds", "obstacle_contact_at_end"}
    after = {name: torch.tensor([[name in on]]) for name in on | off}
    after |= {**poses_of(scenario), "reward": torch.tensor([[2.5]])}
    step = TensorDict({"next": after}, [1])
    ((row, episode),) = _record(step, [begun(scenario)], None, None, None)
    metrics = episode.metrics
    assert (row, metrics.steps, metrics.episode_return) == (0, 1, 2.5)
    assert (metrics.success, metrics.out_of_bounds) == (True, False)
    assert (metrics.contact_rate, metrics.contact_rate_at_end) == (0.0, 1.0)
    assert (metrics.collision_rate_object, metrics.collision_rate_arm) == (1.0, 0.0)
    assert (metrics.collision_rate_at_end, metrics.collision_rate_object_at_end) == (1.0, 0.0)
    # Arm and object, object and obstacle, arm and obstacle.
    assert episode.trajectory.contacts.tolist() == [[False, True, False]]


def test_the_shortest_path_is_by_the_circle_that_the_set_says(free: EvaluationSet) -> None:
    # A wall across the way with a gap of 6.4 cm: the cube's inscribed circle of 5 cm passes straight
    # through, 0.4 m; its circumscribed one of 7.1 cm has to go round one of the ends.
    walls = [Obstacle((0.2, 0.06, 0.06), (0.475 + side * 0.132, 0.0, 0.0)) for side in (-1, 1)]
    scenario = replace(
        free.scenarios[0],
        obstacles=tuple(walls),
        object_pose=(0.475, 0.2, 0.5),
        goal_position=(0.475, -0.2),
    )
    lengths = {}
    for inflation in ("inscribed", "circumscribed"):
        log = begun(scenario, inflation)
        log.flags, log.rewards = [[False] * 6], [0.0]
        log.poses = {key: value * 2 for key, value in log.poses.items()}
        lengths[inflation] = log.finish(False, False).metrics.shortest_length
    assert lengths["inscribed"] == pytest.approx(0.4, rel=1e-3)
    assert lengths["circumscribed"] > 0.5


def test_scenes_that_are_free_get_the_episodes_that_follow(free: EvaluationSet) -> None:
    asked = {}

    def reset(td: TensorDictBase, scenarios: list[Scenario]) -> TensorDictBase:
        asked["mask"], asked["scenarios"] = td["_reset"].flatten().tolist(), scenarios
        return td

    poses = torch.arange(9.0).reshape(3, 3)
    td = TensorDict({"object_pose": poses, "ee_pose": -poses}, [3])
    logs = [None, begun(free.scenarios[0]), None]
    refill = [(2, (7, free.scenarios[7])), (0, (5, free.scenarios[5]))]
    after = _restart(
        SimpleNamespace(reset=reset), td, logs, refill, partial(_Log, inflation="inscribed")
    )
    # The environment takes them in the order of its scenes.
    assert asked == {
        "mask": [True, False, True],
        "scenarios": [free.scenarios[5], free.scenarios[7]],
    }
    assert "_reset" not in after
    assert [log.number for log in logs] == [5, 0, 7]
    assert [log.inflation for log in logs] == ["inscribed", "circumscribed", "inscribed"]
    assert [logs[row].poses["object_pose"] for row in (0, 2)] == [[[0, 1, 2]], [[6, 7, 8]]]


def test_idle_scenes_do_not_mind_what_the_policy_does(env: EnvBase, free: EvaluationSet) -> None:
    def policy(td: TensorDictBase) -> TensorDictBase:
        td = ScriptedPusher()(td)
        td["action"][1:] = torch.nan  # only the first scene has an episode
        return td

    (episode,) = run_episodes(env, policy, [(0, free.scenarios[0])])
    assert episode.metrics.steps > 0


def test_a_policy_state_is_carried_over_and_begins_again(env: EnvBase, free: EvaluationSet) -> None:
    """Counts its own steps; starts again where `is_init` says so."""
    seen: list[list[int]] = []

    def policy(td: TensorDictBase) -> TensorDictBase:
        count = td.get("count", torch.zeros(3, 1, dtype=torch.int64))
        count = torch.where(td["is_init"], 0, count)
        seen.append(count.flatten().tolist())
        td = ScriptedPusher()(td)
        td["next", "count"] = count + 1
        return td

    steps = {
        e.number: e.metrics.steps
        for e in run_episodes(env, policy, list(enumerate(free.scenarios))[:5])
    }
    # All zeros are beginnings: five episodes, each counted up to its own length.
    assert sum(count == 0 for row in seen for count in row) == 5
    assert max(max(row) for row in seen) >= max(steps.values()) - 1
    first_three = [[row[k] for row in seen[: steps[k]]] for k in range(3)]
    assert first_three == [list(range(steps[k])) for k in range(3)]


def test_rewards_contacts_paths_and_targets_are_recorded(env: EnvBase, free: EvaluationSet) -> None:
    path = torch.zeros(3, 4, 2)

    def policy(td: TensorDictBase) -> TensorDictBase:
        td = ScriptedPusher()(td)
        td["way"], td["next", "state", "target"] = path.clone(), td["goal_position"]
        path.add_(1.0)
        return td

    calls = []
    (episode,) = run_episodes(
        env,
        policy,
        [(7, free.scenarios[7])],
        path_key="way",
        target_key=("next", "state", "target"),
        on_step=lambda scene, number: calls.append((scene, number)),
    )
    trajectory = episode.trajectory
    assert (trajectory.planned_path == 0).all()  # the first one
    expected = np.tile(free.scenarios[7].goal_position, (episode.metrics.steps, 1))
    np.testing.assert_allclose(trajectory.target, expected, atol=1e-6)
    assert calls == [(0, 7)] * episode.metrics.steps
    assert episode.metrics.episode_return == float(episode.metrics.success)
    assert trajectory.contacts[:, 0].any()


def test_transforms_do_not_change_where_an_episode_begins(
    env: EnvBase, free: EvaluationSet
) -> None:
    stacked = TransformedEnv(
        PushEnv(2, pushed_object=("small_cube",)),
        Compose(
            OccupancyGrid(object_radius_key="object_radius"),
            PlannerSubgoals(DistanceField()),
        ),
    )
    numbered = list(enumerate(free.scenarios))[:3]
    follows = ScriptedPusher(target_key="subgoal")
    plain = {e.number: e for e in run_episodes(env, ScriptedPusher(), numbered)}
    planned = {e.number: e for e in run_episodes(stacked, follows, numbered)}
    stacked.close()
    for number, scenario in numbered:
        for episodes in (plain, planned):
            begin = episodes[number].trajectory
            np.testing.assert_allclose(begin.object_pose[0], scenario.object_pose, atol=2e-3)
            np.testing.assert_allclose(begin.ee_pose[0, :2], scenario.tool_pose[:2], atol=2e-3)
        lengths = [e[number].metrics.shortest_length for e in (plain, planned)]
        assert lengths[0] == lengths[1]


def test_what_transforms_must_not_drop_is_named(env: EnvBase, free: EvaluationSet) -> None:
    incomplete = TransformedEnv(
        PushEnv(1, depth=None), ExcludeTransform("tool_obstacle_contact", "ee_pose")
    )
    still = TensorDictModule(
        lambda pose: torch.zeros_like(pose), in_keys=["object_pose"], out_keys=["action"]
    )
    with pytest.raises(
        KeyError, match=r"must emit .*'ee_pose', 'tool_obstacle_contact'.* there is"
    ):
        list(run_episodes(incomplete, still, [(0, free.scenarios[0])]))
    incomplete.close()


def test_another_workspace_than_the_sets_is_refused() -> None:
    rng = np.random.default_rng(0)
    env = PushEnv(1, depth=None, low=(0.4, -0.45), high=(0.7, -0.36), distance=(0.06, 0.1))
    with pytest.raises(
        ValueError, match=r"run_episodes: the environment must have the .* workspace"
    ):
        next(iter(run_episodes(env, ScriptedPusher(), [(0, sample_scenario(rng, env.scenario))])))
    env.close()


def test_a_policy_s_own_tensors_stay_what_they_are(env: EnvBase) -> None:
    """Of three scenes one has no second episode; the policy gives all the same memory."""
    own = torch.tensor([-1.0, 0.5, 0.0])

    def act(td: TensorDictBase) -> TensorDictBase:
        return td.set("action", own.expand(3, 3))

    scenarios = load_set("free/small_cube").scenarios[:4]
    episodes = {e.number: e for e in run_episodes(env, act, enumerate(scenarios))}
    assert own.tolist() == [-1.0, 0.5, 0.0]
    again = {e.number: e for e in run_episodes(env, act, enumerate(scenarios[3:], 3))}
    np.testing.assert_array_equal(episodes[3].trajectory.ee_pose, again[3].trajectory.ee_pose)
    assert len(episodes[3].trajectory.contacts) > 10
