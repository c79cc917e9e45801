"""Observations of order 1: for the networks, and since attentive replay compares them by cosine."""

import pytest
import torch

from modpush.envs.scenes.layouts import SCENES
from modpush.mdp import PushObservation
from modpush.recipes import PushEnvConfig, make_push_env

CONSTANT = {
    # Pitch and roll: the tool points down. The fifth joint: it keeps the tool so.
    "ee_pose": (3, 4),
    "joint_position": (4,),
}
"""Components that do not vary."""
CONSTANT_ON_THE_PATH = {
    **CONSTANT,
    # x points to the present sub-goal, and a random action hardly ever moves the object away from it.
    "subgoal_past": (1, 3),
    # Goals are far from the edges beyond them, while the object has not been pushed close.
    "edges": (0,),
}
"""The same in the path's frame, in random states."""
STRAIGHT = {"path_ahead": (0, 1, 2, 3)}
"""Components that hardly vary in random states, without being zero: the first 0.2 m of most paths are
straight."""
LARGEST_SHARE = 0.5
"""Of an observation's squared norm, of any one entry on average."""


@pytest.fixture(scope="module", params=["paper", "cpu"])
def entries(request):
    """Observations by entry, `[N, n]`, of random actions in every scene family."""
    torch.manual_seed(0)
    config = PushEnvConfig.preset(request.param, num_envs=4, scene=tuple(SCENES))
    env = make_push_env(config, seed=5)
    rollouts = [env.rollout(6, break_when_any_done=False)["observation"] for _ in range(10)]
    observed = torch.cat([rollout.flatten(0, 1) for rollout in rollouts])
    (transform,) = [t for t in env.transform if isinstance(t, PushObservation)]
    env.close()
    return {name: observed[:, columns] for name, columns in transform.columns.items()}


@pytest.fixture
def constant(entries):
    """Indices of the components that do not vary here, by entry."""
    return CONSTANT_ON_THE_PATH if "object_axis" in entries else CONSTANT


def test_every_component_is_of_order_1(entries, constant):
    for name, values in entries.items():
        size = values.square().mean(0).sqrt()
        assert values.abs().max() < 6, name
        assert size.max() < 2, (name, size)
        steady = (*constant.get(name, ()), *STRAIGHT.get(name, ()))
        varying = [i for i in range(len(size)) if i not in steady]
        # Some of the latent's components, and a tool in contact, are rare in random states.
        least = 0.02 if name in ("latent", "contact") else 0.1
        assert values[:, varying].std(0).min() > least, (name, values.std(0))
        assert size[list(constant.get(name, ()))].abs().sum() < 0.05, (name, size)


def test_the_latent_as_a_whole_varies_by_order_1(entries):
    assert 0.2 < entries["latent"].square().mean().sqrt() < 2


def test_no_entry_decides_the_cosine_alone(entries):
    squares = {name: values.square().sum(-1) for name, values in entries.items()}
    total = sum(squares.values())
    for name, square in squares.items():
        assert (square / total).mean() < LARGEST_SHARE, name
        assert square.sum() / total.sum() < LARGEST_SHARE, name
