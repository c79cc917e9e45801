"""The paper's reward, by hand."""

import pytest
import torch
from tensordict import TensorDict
from torchrl.data import LazyTensorStorage, ReplayBuffer
from torchrl.envs import Compose, TransformedEnv, check_env_specs

from modpush.envs import PushEnv
from modpush.mdp import REWARD_TERMS, ActionFrame, PushReward, RewardConfig, RewardKeys
from tests.mdp.own_parts import effort
from tests.mdp.straight_path import StraightPath

FLAGS = (
    "object_contact",
    "obstacle_contact",
    "tool_obstacle_contact",
    "success",
    "out_of_bounds",
)


def step(path=0.3, apart=0.1, **flags):
    """What a step led to: the object at the origin, the tip `apart` metres from it."""
    state = {
        "path_length": torch.tensor([[path]]),
        "object_pose": torch.zeros(1, 3),
        "ee_pose": torch.tensor([[apart, 0.0, 0.0]]),
    }
    state |= {name: torch.tensor([[flags.get(name, False)]]) for name in FLAGS}
    return TensorDict(state, [1])


def transition(start=(0.6, 0.2), before=None, **after):
    state = (before or step()).set("reward_start", torch.tensor([start]))
    return state.set("action", torch.tensor([[0.5, -1.0, 0.0]])).set("next", step(**after))


def reward_of(config=None, start=(0.6, 0.2), terms=None, **after):
    reward = PushReward(config or RewardConfig(), terms=terms)
    return reward(transition(start, **after))["next"]


@pytest.mark.parametrize(
    ("after", "expected"),
    [
        # half the path left, tip at half its first distance: -0.5 - 0.5
        ({}, -1.0),
        # in contact the approach's part is given back
        ({"object_contact": True}, -0.5),
        ({"obstacle_contact": True}, -1.0 - 5),
        ({"tool_obstacle_contact": True}, -1.0),  # only the object's collisions count
        ({"out_of_bounds": True}, -1.0 - 10),
        # shares are clipped at 1: farther away than at the start costs no more
        ({"path": 0.9, "apart": 0.5}, -2.0),
        # at the goal 50, and no distances; contact still gives +0.5
        ({"success": True}, 50.0),
        ({"success": True, "object_contact": True}, 50.5),
    ],
)
def test_the_papers_numbers(after, expected):
    assert reward_of(**after)["reward"].item() == pytest.approx(expected, abs=1e-6)


def test_the_terms_add_up_and_are_scaled():
    after = reward_of(RewardConfig(scale=0.1), obstacle_contact=True)
    assert after["reward"].item() == pytest.approx(-0.6)
    assert sum(after["reward_terms"].values()).item() == pytest.approx(-0.6)
    assert after["reward_terms", "object_collision"].item() == pytest.approx(-0.5)


def test_constant_normalisation_divides_by_its_lengths():
    config = RewardConfig(scale=1.0, normalisation="constant")  # by 0.6 and 0.15 m
    reward = reward_of(config, start=(9.0, 9.0), path=0.3, apart=0.075)["reward"]
    assert reward.item() == pytest.approx(-1.0)


def test_a_term_of_your_own_reads_the_outcome():
    config = RewardConfig(scale=1.0, weights={"goal": 1.0, "patience": 3.0})
    terms = {"patience": lambda outcome: -outcome.path_fraction}
    assert reward_of(config, terms=terms)["reward"].item() == pytest.approx(-1.5)


def test_a_penalty_for_the_action():
    config = RewardConfig(scale=0.1, weights={"effort": 2.0})
    # 0.5^2 + 1^2 = 1.25, times 2, times the scale
    assert reward_of(config, terms={"effort": effort})["reward"].item() == pytest.approx(-0.25)
    by_text = RewardConfig(scale=0.1, weights={"tests.mdp.own_parts:effort": 2.0})
    after = reward_of(by_text)
    assert after["reward"].item() == pytest.approx(-0.25)
    assert after["reward_terms", "effort"].item() == pytest.approx(-0.25)
    named = RewardConfig(scale=0.1, weights={"laziness": 2.0})
    after = reward_of(named, terms={"laziness": "tests.mdp.own_parts:effort"})
    assert after["reward_terms", "laziness"].item() == pytest.approx(-0.25)


def test_a_term_that_reads_keys_of_your_own_before_and_after():
    def cooling(outcome):
        return outcome.before["arm", "heat"] - outcome["arm", "heat"]

    stored = transition()
    stored["arm", "heat"] = torch.tensor([[3.0]])
    stored["next", "arm", "heat"] = torch.tensor([[1.0]])
    config = RewardConfig(scale=1.0, weights={"cooling": 1.0})
    reward = PushReward(config, terms={"cooling": cooling})
    assert reward(stored)["next", "reward"].item() == 2.0
    with pytest.raises(KeyError, match=r"key .*arm.*heat.* is missing"):
        reward(stored.exclude(("arm", "heat")))
    del stored["next", "arm", "heat"]
    with pytest.raises(KeyError, match=r"key .*arm.*heat.* is missing"):
        reward(stored)


@pytest.mark.parametrize(
    ("moved", "path", "expected"),
    [
        # the object starts 0.30 m from the goal along the path
        (0.02, 0.28, 0.0),  # straight along the path
        (0.02, 0.30, -0.02),  # sideways
        (0.02, 0.31, -0.03),  # away from the goal
        (0.02, 0.40, -0.05),  # the path became much longer: clipped
        (0.00, 0.25, 0.0),  # a shorter path was found
    ],
)
def test_a_detour_costs_what_the_object_moved_without_progress(moved, path, expected):
    stored = transition(path=path)
    stored["next", "object_pose"][:, 1] = moved
    stored["next", "object_pose"][:, 2] = 0.7  # turning on the spot is no detour
    config = RewardConfig(scale=1.0, weights={"detour": 1.0})
    reward = PushReward(config)(stored)["next", "reward"].item()
    assert reward == pytest.approx(expected, abs=1e-6)


def test_a_step_without_contact_costs_until_the_goal_is_reached():
    config = RewardConfig(scale=1.0, weights={"no_contact": 1.0})
    costs = [
        reward_of(config, object_contact=contact, success=success)["reward"].item()
        for contact, success in ((False, False), (True, False), (False, True), (True, True))
    ]
    assert costs == [-1, 0, 0, 0]


def test_every_term_has_its_sign():
    after = {"object_contact": True, **dict.fromkeys(FLAGS[1:], True), "apart": 0.2, "path": 0.4}
    weights = dict.fromkeys(REWARD_TERMS, 1.0)
    td = transition(**after)
    for state, turn in ((td, 0.3), (td["next"], 0.2)):
        state["pose_error"] = torch.tensor([[0.0, turn]])
        state["object_radius"] = torch.tensor([[1.0]])
    terms = PushReward(RewardConfig(scale=1.0, weights=weights))(td)["next", "reward_terms"]
    # Distance and approach count for nothing once the goal is reached.
    assert {name: terms[name].sign().item() for name in terms.keys()} == {
        "goal": 1,
        "touch": 1,
        "distance": 0,
        "approach": 0,
        "object_collision": -1,
        "tool_collision": -1,
        "out_of_bounds": -1,
        "window": -1,
        "no_contact": 0,
        "detour": -1,
        "pose_progress": -1,  # turned a little nearer, but 10 cm farther away
    }


def test_a_term_of_a_wrong_shape_is_named():
    config = RewardConfig(weights={"flat": 1.0})
    with pytest.raises(ValueError, match=r"term 'flat' must be \[1, 1\], got \[1\]"):
        reward_of(config, terms={"flat": lambda outcome: outcome.path_fraction[..., 0]})


def test_nested_keys_are_read():
    names = [*FLAGS, "object_pose", "ee_pose", "path_length"]
    stored = transition(obstacle_contact=True, object_contact=True)
    deep = TensorDict({"reward_start": stored["reward_start"]}, [1])
    deep["my", "action"] = stored["action"]
    deep["next"] = TensorDict({"deep": stored["next"].select(*names)}, [1])
    config = RewardConfig(weights={**RewardConfig().weights, "effort": 1.0})
    keys = RewardKeys(action=("my", "action"), **{name: ("deep", name) for name in names})
    terms = {"effort": lambda outcome: -outcome.action.norm(dim=-1, keepdim=True)}
    nested = PushReward(config, terms=terms, keys=keys)
    flat = PushReward(config, terms=terms)
    assert torch.equal(nested(deep)["next", "reward"], flat(stored)["next", "reward"])


@pytest.mark.parametrize("group", ["", "mine"])
def test_other_keys_are_written(group):
    def key(name):
        return (group, name) if group else name

    reward = PushReward(
        reward_key=key("progress"), terms_key=key("parts"), start_key=key("lengths")
    )
    env = TransformedEnv(PushEnv(2, depth=None, seed=0), Compose(StraightPath(), reward))
    check_env_specs(env)
    rollout = env.rollout(3, break_when_any_done=False)
    following = rollout["next"]
    parts = following[key("parts")]
    total = sum(parts[name] for name in parts.keys())
    torch.testing.assert_close(following[key("progress")], total)
    assert following[key("lengths")].shape == (2, 3, 2)
    assert following["reward"].eq(0).all()  # the environment's own: it is not solved by chance
    env.close()


def test_stored_transitions_are_rewarded_as_the_environment_did():
    config = RewardConfig(weights={**RewardConfig().weights, "effort": 1.0, "detour": 10.0})
    reward = PushReward(config, terms={"effort": effort})
    stack = Compose(StraightPath(), ActionFrame("path"), reward)
    env = TransformedEnv(PushEnv(2, depth=None, seed=0), stack)
    rollout = env.rollout(6, break_when_any_done=False).reshape(-1)
    env.close()
    # Also where the action was turned into the base frame for the robot.
    expected = -rollout["action"].square().sum(-1, keepdim=True)
    torch.testing.assert_close(rollout["next", "reward_terms", "effort"], expected)
    buffer = ReplayBuffer(
        storage=LazyTensorStorage(12),
        transform=PushReward(config, terms={"effort": effort}),
        batch_size=12,
    )
    stored = rollout.clone()
    stored["next", "reward"].zero_()
    buffer.extend(stored.set("index", torch.arange(12)))
    sample = buffer.sample()
    assert torch.equal(sample["next", "reward"], rollout["next", "reward"][sample["index"]])


def test_a_partial_reset_begins_again_in_that_scene_only():
    env = TransformedEnv(PushEnv(2, depth=None, seed=0), Compose(StraightPath(), PushReward()))
    td = env.reset()
    first = td["reward_start"].clone()
    for _ in range(3):
        td = env.step(td.set("action", torch.tensor([[0.3, 0.1, 0.0]] * 2)))["next"]
        assert torch.equal(td["reward_start"], first)
    td["_reset"] = torch.tensor([[False], [True]])
    td = env.reset(td)
    assert torch.equal(td["reward_start"][0], first[0])
    assert not torch.equal(td["reward_start"][1], first[1])
    apart = (td["ee_pose"][:, :2] - td["object_pose"][:, :2]).norm(dim=-1)
    torch.testing.assert_close(td["reward_start"][1, 1], apart[1])
    env.close()
