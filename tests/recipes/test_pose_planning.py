"""`make_push_env(plan_poses=True)`: what is emitted, observed and rewarded."""

import math

import pytest
import torch
from torchrl.envs.utils import check_env_specs

from modpush import PushEnvConfig, make_push_env
from modpush.mdp import POSE_ENTRIES, PushObservation, RewardConfig

OWN = ("subgoal_pose", "turns_ahead", "pose_path_length")


@pytest.fixture(scope="module")
def env():
    config = PushEnvConfig.preset(
        "cpu",
        num_envs=2,
        goal="pose",
        plan_poses=True,
        pushed_object="box",
        scene="one_l",
        tool_start="behind",
        encoder="none",
        entries=(*(name for name in POSE_ENTRIES if name != "latent"), *OWN),
        raw=True,
        reward=RewardConfig(weights={"pose_progress": 1.0}),
    )
    env = make_push_env(config, mirrored=True, seed=3)
    yield env
    env.close()


def test_it_is_an_environment(env) -> None:
    check_env_specs(env, seed=0)


def test_a_planned_path_is_observed_and_its_cost_rewarded(env) -> None:
    def ahead_along_the_path(td):
        return td.set("action", torch.tensor([[1.0, 0.0, 0.0]]).expand(2, 3))

    td = env.rollout(15, ahead_along_the_path, break_when_any_done=False)
    before, after = td.exclude("next"), td["next"]
    assert after["pose_path_found"].all()
    length = after["pose_path_length"]
    distance, turn = after["pose_error"].abs().split(1, -1)
    radius = after["object_support"].amax(-1, keepdim=True)  # the turning radius
    # No path is shorter than the straight way and turn; at 2 cm and 22.5 degrees, but for a cell.
    assert (length >= distance + radius * turn - 1e-4).all()
    assert not torch.equal(length, distance + radius * turn)

    columns = next(t for t in env.transform if isinstance(t, PushObservation)).columns
    seen, mirrored = (
        {name: after[key][..., columns[name]] for name in OWN}
        for key in ("observation", "mirrored_observation")
    )
    pose = after["object_pose"]
    way = after["subgoal_pose"] - pose
    assert torch.allclose(seen["subgoal_pose"][..., 2], way[..., 2], atol=1e-5)
    assert torch.allclose(
        seen["subgoal_pose"][..., :2].norm(dim=-1), way[..., :2].norm(dim=-1), atol=1e-5
    )
    ahead = (after["subgoal"] - pose[..., :2]) / (after["subgoal"] - pose[..., :2]).norm(
        dim=-1, keepdim=True
    )
    assert torch.allclose(
        seen["subgoal_pose"][..., 0], (way[..., :2] * ahead).sum(-1), atol=1e-5
    )  # along the path's x
    assert torch.allclose(
        seen["turns_ahead"], after["pose_path_ahead"][..., 2] - pose[..., 2:], atol=1e-5
    )
    assert seen["turns_ahead"].abs().max() > math.radians(5)
    assert torch.equal(seen["pose_path_length"], length)
    signs = torch.tensor([1.0, -1.0, -1.0])
    assert torch.equal(mirrored["subgoal_pose"], seen["subgoal_pose"] * signs)
    assert torch.equal(mirrored["turns_ahead"], -seen["turns_ahead"])

    first, last = before["pose_path_length"], length
    progress = first - last + 2 * (first.clamp_max(0.04) - last.clamp_max(0.04))
    assert torch.allclose(after["reward"], progress, atol=1e-6)
    assert progress.abs().max() > 1e-3


def test_with_noise_the_policy_plans_from_what_it_observes_and_the_reward_from_the_truth() -> None:
    env = make_push_env(
        num_envs=2,
        goal="pose",
        plan_poses=True,
        pushed_object="box",
        encoder="none",
        reward=RewardConfig(weights={"pose_progress": 1.0}),
        position_noise=0.01,
        seed=3,
    )
    td = env.rollout(5)
    env.close()
    first, last = td["true", "pose_path_length"], td["next", "true", "pose_path_length"]
    assert not torch.allclose(last, td["next", "pose_path_length"], atol=1e-3)
    progress = first - last + 2 * (first.clamp_max(0.04) - last.clamp_max(0.04))
    assert torch.allclose(td["next", "reward"], progress, atol=1e-6)
