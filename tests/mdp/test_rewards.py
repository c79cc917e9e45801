"""The paper's reward, by hand."""

import pytest
import torch
from tensordict import TensorDict
from torchrl.envs import TransformedEnv
from torchrl.envs.transforms import Compose

from modpush.envs import PushEnv
from modpush.mdp.rewards import REWARD_TERMS, PushReward, RewardConfig
from tests.mdp.straight_path import StraightPath

FLAGS = (
    *("object_contact", "obstacle_contact", "tool_obstacle_contact"),
    *("success", "out_of_bounds"),
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


def reward_of(config=None, start=(0.6, 0.2), **happened):
    stored = TensorDict({"reward_start": torch.tensor([start]), "next": step(**happened)}, [1])
    return PushReward(config or RewardConfig(scale=1.0))(stored)["next"]


@pytest.mark.parametrize(
    ("happened", "expected"),
    [
        # half the path left, tip at half its first distance: -0.5 - 0.5
        ({}, -1.0),
        # in contact the approach's part is given back
        ({"object_contact": True}, -0.5),
        ({"obstacle_contact": True}, -1.0 - 5),
        ({"tool_obstacle_contact": True}, -1.0 - 2),
        ({"out_of_bounds": True}, -1.0 - 10),
        # shares are clipped at 1: farther away than at the start costs no more
        ({"path": 0.9, "apart": 0.5}, -2.0),
        # at the goal 50, and no distances; contact still gives +0.5
        ({"success": True}, 50.0),
        ({"success": True, "object_contact": True}, 50.5),
    ],
)
def test_the_papers_numbers(happened, expected):
    assert reward_of(**happened)["reward"].item() == pytest.approx(expected, abs=1e-6)


def test_the_terms_add_up_and_are_scaled():
    after = reward_of(RewardConfig(), obstacle_contact=True)
    assert after["reward"].item() == pytest.approx(-0.6)
    assert sum(after["reward_terms"].values()).item() == pytest.approx(-0.6)
    assert after["reward_terms", "object_collision"].item() == pytest.approx(-0.5)


def test_constant_normalisation_divides_by_its_lengths():
    config = RewardConfig(scale=1.0, normalisation="constant")  # by 0.6 and 0.15 m
    reward = reward_of(config, start=(9.0, 9.0), path=0.3, apart=0.075)["reward"]
    assert reward.item() == pytest.approx(-1.0)


def test_the_window_penalty_is_off_unless_weighted():
    assert "window" not in reward_of(apart=0.15).get("reward_terms").keys()
    config = RewardConfig(scale=1.0, weights={"window": 2.0})
    assert reward_of(config, apart=0.15)["reward"].item() == -2.0
    assert reward_of(config, apart=0.10)["reward"].item() == 0.0


def test_a_term_of_ones_own():
    config = RewardConfig(scale=1.0, weights={"goal": 1.0, "patience": 3.0})
    transform = PushReward(config, terms={"patience": lambda happened: -happened.path})
    stored = TensorDict({"reward_start": torch.tensor([[0.6, 0.2]]), "next": step()}, [1])
    assert transform(stored)["next", "reward"].item() == pytest.approx(-1.5)


def test_every_term_has_its_sign():
    happened = {"object_contact": True, **dict.fromkeys(FLAGS[1:], True), "apart": 0.2}
    weights = dict.fromkeys(REWARD_TERMS, 1.0)
    terms = reward_of(RewardConfig(scale=1.0, weights=weights), **happened)["reward_terms"]
    signs = {name: terms[name].sign().item() for name in terms.keys()}
    # Distance and approach count for nothing once the goal is reached.
    assert signs == {
        **{"goal": 1, "touch": 1, "distance": 0, "approach": 0, "window": -1},
        **{"object_collision": -1, "tool_collision": -1, "out_of_bounds": -1},
    }


def test_bad_configs_are_refused():
    with pytest.raises(ValueError, match=r"no terms .'speed'., expected some of"):
        PushReward(RewardConfig(weights={"speed": 1.0}))
    with pytest.raises(ValueError, match="scale must be > 0, got 0"):
        RewardConfig(scale=0.0)
    with pytest.raises(ValueError, match="normalisation must be"):
        RewardConfig(normalisation="none")
    with pytest.raises(ValueError, match="keys has no"):
        PushReward(keys={"length": "path_length"})
    incomplete = {"reward_start": torch.ones(1, 2), "next": step().exclude("path_length")}
    with pytest.raises(KeyError, match="'path_length' is missing"):
        PushReward()(TensorDict(incomplete, [1]))


def test_a_partial_reset_begins_anew_in_that_scene_only():
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
