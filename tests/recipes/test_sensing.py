"""Delays and noise in the stack of an agent, and in the evaluation sets."""

import math

import pytest
import torch
from torchrl.envs import check_env_specs

from modpush import PushEnvConfig, evaluate, load_agent, make_push_env
from modpush.envs import SENSING, EpisodeConditions
from modpush.evaluation import EvaluationConfig, load_set
from modpush.mdp import ActionDelay, ObservationDelay, PoseNoise, StuckRecovery
from modpush.recipes import get_method

CPU = PushEnvConfig.preset("cpu", num_envs=2)
DELAYS = (ActionDelay, ObservationDelay, PoseNoise)


def kinds(env) -> list[type]:
    return [type(t) for t in env.transform if isinstance(t, DELAYS)]


def rollout(env, steps: int = 12):
    """States of random actions, `[B, steps]`; the same in every environment."""
    actions = torch.rand(steps, *env.batch_size, 3, generator=torch.manual_seed(2)) * 2 - 1
    numbers = iter(actions)
    return env.rollout(steps, lambda td: td.set("action", next(numbers)), break_when_any_done=False)


def test_by_default_the_stack_has_nothing_of_it() -> None:
    env, same = make_push_env(CPU, seed=0), make_push_env(CPU, seed=0, action_delay=0)
    assert kinds(env) == kinds(same) == []
    keys = {str(key) for key in env.observation_spec.keys(True, True)}
    assert not [key for key in keys if "observed" in key or "stream" in key or "true" in key]
    env.close()
    same.close()


@pytest.mark.parametrize("name", ["noise", "delay", "noise_delay"])
def test_torchrl_s_checks_of_the_whole_stack(name) -> None:
    env = make_push_env(CPU, seed=0, sensing=SENSING[name], mirrored=True)
    check_env_specs(env, break_when_any_done="both")
    assert not {"depth", "occupancy"} & set(env.rollout(2).keys())
    env.close()


def test_the_observation_is_that_of_the_step_before() -> None:
    late = make_push_env(CPU, seed=0, observation_delay=1, leave_out=["subgoal_past"])
    present = make_push_env(CPU, seed=0, leave_out=["subgoal_past"], action_frame="base")
    assert kinds(late) == [ObservationDelay]
    late.close()
    late = make_push_env(
        CPU, seed=0, observation_delay=1, leave_out=["subgoal_past"], action_frame="base"
    )
    a, b = rollout(late), rollout(present)
    torch.testing.assert_close(a["next", "object_pose"], b["next", "object_pose"])
    torch.testing.assert_close(a["next", "observation"][:, 1:], b["next", "observation"][:, :-1])
    torch.testing.assert_close(a["observation"][:, 0], b["observation"][:, 0])
    # Reward and its terms are of the true state.
    torch.testing.assert_close(a["next", "reward"], b["next", "reward"])
    assert (a["next", "observation"] != b["next", "observation"]).any()
    late.close()
    present.close()


def test_noise_changes_what_is_observed_and_not_the_reward() -> None:
    exact = make_push_env(CPU, seed=0, action_frame="base")
    noisy = make_push_env(CPU, seed=0, action_frame="base", sensing=SENSING["noise"])
    a, b = rollout(noisy), rollout(exact)
    assert kinds(noisy) == [PoseNoise]
    torch.testing.assert_close(a["next", "reward"], b["next", "reward"])
    assert torch.equal(a["next", "object_pose"], b["next", "object_pose"])
    assert not torch.equal(a["next", "path_length"], b["next", "path_length"])
    torch.testing.assert_close(a["next", "true", "path_length"], b["next", "path_length"])
    off = (a["observed", "object_pose"] - a["object_pose"]).abs()
    assert 0.005 < off[..., :2].max() <= 0.015 + 1e-6
    assert off[..., 2].max() <= math.radians(7.5) + 1e-6
    noisy.close()
    exact.close()


def test_a_shipped_agent_runs_with_delays_and_noise() -> None:
    agent = load_agent("any_object")
    env = agent.make_env(2, seed=0, action_delay=(1, 3), position_noise=0.015, yaw_noise=0.13)
    assert kinds(env) == [ActionDelay, PoseNoise]
    recovery = next(t for t in env.transform if isinstance(t, StuckRecovery))
    assert recovery.patience == 4 + 3
    assert recovery.in_keys == ["ee_pose", ("observed", "object_pose")]
    first = env.rollout(20, agent.policy, break_when_any_done=False)
    env.set_seed(0)
    again = env.rollout(20, agent.policy, break_when_any_done=False)
    assert torch.equal(first["next", "observation"], again["next", "observation"])
    env.close()


def test_a_set_with_other_conditions_has_another_name_and_its_conditions_are_stored() -> None:
    smoke = load_set("smoke")
    other = smoke.with_conditions(sensing="noise_delay")
    assert (other.name, other.digest) == ("smoke+noise_delay", smoke.digest)
    stored = other.conditions.to_dict()
    assert stored["sensing"]["action_delay"] == [1, 3]
    assert EpisodeConditions.from_dict(stored) == other.conditions
    assert "sensing" not in smoke.conditions.to_dict()
    assert smoke.with_conditions(sensing="exact") is smoke
    with pytest.raises(ValueError, match="sensing: Input should be 'exact', 'noise', 'delay'"):
        smoke.with_conditions(sensing="late")  # type: ignore[arg-type]


def test_an_evaluation_has_the_set_s_conditions_whatever_an_agent_was_trained_with() -> None:
    method = get_method("any_object")
    conditions = EpisodeConditions(sensing=SENSING["noise_delay"])
    for given, found in ((conditions, list(DELAYS)), (EpisodeConditions(), [])):
        env = method.make_env(1, ("small_cube",), given)
        assert sorted(kinds(env), key=str) == sorted(found, key=str)
        env.close()


def test_an_episode_s_rows_do_not_depend_on_the_size_of_the_batch(tmp_path) -> None:
    episodes = load_set("smoke").first(6).with_conditions(sensing="noise_delay")
    method = get_method("small_cube")
    rows = [
        evaluate(method, episodes, tmp_path / str(n), config=EvaluationConfig(num_envs=n))
        for n in (4, 6)
    ]
    again = evaluate(method, episodes, tmp_path / "4")  # finished: only read
    assert again.equals(rows[0])
    assert rows[0]["success"].tolist() == rows[1]["success"].tolist()
    assert rows[0]["steps"].tolist() == rows[1]["steps"].tolist()


def test_hand_written_policies_and_factories_without_conditions_refuse(tmp_path) -> None:
    conditions = EpisodeConditions(sensing=SENSING["noise"])
    with pytest.raises(ValueError, match="sensing must be exact for a hand-written policy"):
        get_method("scripted").make_env(1, ("small_cube",), conditions)
    with pytest.raises(ValueError, match="make_env must have a parameter `conditions`"):
        evaluate(
            get_method("small_cube").make_policy(),
            load_set("smoke").first(1).with_conditions(sensing="noise"),
            tmp_path,
            make_env=lambda num_envs, objects: make_push_env(CPU),
        )
