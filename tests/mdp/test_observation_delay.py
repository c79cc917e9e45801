"""Measurements of a `PushEnv` that arrive late, and the noise of a pose."""

import math

import pytest
import torch
from torchrl.envs import Compose, SerialEnv, TransformedEnv, check_env_specs

from modpush.envs import PushEnv
from modpush.mdp import ObservationDelay, PoseNoise

KEYS = ["object_pose", "ee_pose", "object_contact", "segmentation"]
OBSERVED = [("observed", key) for key in KEYS]


def make(steps, scenes=2) -> TransformedEnv:
    base = PushEnv(scenes, scene="slot", seed=0)
    return TransformedEnv(base, ObservationDelay(steps, in_keys=KEYS, out_keys=OBSERVED))


def pushing(td):
    """Towards the object: poses, contact and images change."""
    towards = (td["object_pose"] - td["ee_pose"]) * 50
    towards[..., 2] = 0.3
    return td.set("action", towards.clamp(-1, 1))


def run(env, steps=14):
    """States at reset and after each step, `[steps + 1, B]`."""
    td = env.reset()
    states = [td.exclude("action", "reward")]
    for _ in range(steps):
        td = env.step_mdp(env.step(pushing(td.clone())))
        states.append(td.exclude("action", "reward"))
    return torch.stack(states)


@pytest.mark.parametrize("steps", [0, 1, 3])
def test_entries_are_those_of_so_many_steps_ago_and_of_the_reset_before(steps: int) -> None:
    env = make(steps)
    states = run(env)
    for key in KEYS:
        truth, observed = states[key], states["observed", key]
        assert (truth[1:] != truth[:-1]).any()
        assert observed.dtype == truth.dtype
        for t in range(len(states)):
            assert torch.equal(observed[t], truth[max(0, t - steps)])
    env.close()


def test_all_entries_have_one_age_which_is_drawn_in_every_step() -> None:
    env = make((0, 2), scenes=4)
    states = run(env, 20)
    counts = [0, 0, 0]
    for t in range(3, 21):
        for scene in range(4):
            same = [
                all(
                    torch.equal(states["observed", key][t, scene], states[key][t - age, scene])
                    for key in KEYS
                )
                for age in range(3)
            ]
            assert any(same)
            if sum(same) == 1:
                counts[same.index(True)] += 1
    assert min(counts) > 10
    env.close()


def test_a_scene_that_is_reset_alone_forgets_and_the_others_do_not() -> None:
    env = make(2)
    states = run(env, 5)
    td = states[-1].clone()
    td["_reset"] = torch.tensor([[True], [False]])
    td = env.reset(td)
    assert torch.equal(td["observed", "ee_pose"][0], td["ee_pose"][0])
    assert torch.equal(td["observed", "ee_pose"][1], states["ee_pose"][3, 1])
    after = env.step(td.set("action", torch.ones(2, 3)))["next"]
    assert torch.equal(after["observed", "ee_pose"][0], td["ee_pose"][0])
    assert torch.equal(after["observed", "ee_pose"][1], states["ee_pose"][4, 1])
    env.close()


def test_torchrl_s_checks() -> None:
    env = make((0, 2))
    check_env_specs(env, break_when_any_done="both")
    env.close()
    serial = SerialEnv(2, lambda: make(1, 1))
    check_env_specs(serial)
    serial.close()


def noisy(scenes=4, episodes=0, **options) -> TransformedEnv:
    noise = PoseNoise(0.015, math.radians(7.5), **options)
    return TransformedEnv(PushEnv(scenes, scene="free", depth=None, seed=episodes), noise)


def errors(env, steps=100):
    states = run(env, steps)
    return states["observed", "object_pose"] - states["object_pose"]


def test_noise_is_uniform_within_its_limits_and_independent_in_every_step() -> None:
    env = noisy()
    error = errors(env) / torch.tensor([0.015, 0.015, math.radians(7.5)])
    assert error.abs().amax() <= 1.0 + 1e-4
    flat = error.flatten(0, 1)  # [404, 3]; standard errors 0.029 of a mean, 0.013 of a deviation
    assert flat.mean(0).abs().amax() < 0.1
    torch.testing.assert_close(flat.std(0), torch.full((3,), 3**-0.5), atol=0.05, rtol=0)
    assert torch.corrcoef(flat.T).triu(1).abs().amax() < 0.15
    lagged = torch.stack([error[1:].flatten(), error[:-1].flatten()])
    assert torch.corrcoef(lagged)[0, 1].abs() < 0.1
    env.close()


def test_an_episode_has_the_same_noise_whatever_runs_beside_it() -> None:
    errors_of = []
    for scenes, episodes, options in ((4, 0, {}), (1, 0, {}), (1, 7, {}), (1, 0, {"seed": 1})):
        torch.manual_seed(len(errors_of))
        env = noisy(scenes, episodes, **options)
        env.reset()  # another episode before
        env.set_seed(episodes)
        errors_of.append(errors(env, 5)[:, 0])
        env.close()
    torch.testing.assert_close(errors_of[0], errors_of[1], atol=1e-6, rtol=0)
    for other in errors_of[2:]:
        assert (errors_of[0] - other).abs().amax() > 1e-3


def test_noise_leaves_torch_s_generator_and_the_true_state_alone() -> None:
    env, plain = noisy(2), PushEnv(2, scene="free", depth=None, seed=0)
    torch.manual_seed(0)
    before = torch.get_rng_state()
    states, truth = run(env, 10), run(plain, 10)
    assert torch.equal(torch.get_rng_state(), before)
    for key in truth.keys(True, True):
        assert torch.equal(states[key], truth[key])
    check_env_specs(env, break_when_any_done="both")
    for one in (env, plain):
        one.close()


def test_a_delayed_measurement_keeps_the_noise_that_it_was_made_with() -> None:
    delay = ObservationDelay(2, in_keys=[("observed", "object_pose")], out_keys=["late"])
    base = PushEnv(1, scene="free", depth=None, seed=0)
    env = TransformedEnv(base, Compose(PoseNoise(0.01, 0.1), delay))
    states = run(env, 6)
    assert torch.equal(states["late"][2:], states["observed", "object_pose"][:-2])
    env.close()
