"""Entries, terms and scenes of a user's own module, for tests that name them `"module:name"`."""

from modpush.envs.scenes.layouts import free
from modpush.mdp import Entry


def speed(inputs):
    return inputs["speed"]


def gap(inputs):
    return inputs.goal - inputs.subgoal


halved_gap = Entry(gap, 0.5)


def effort(outcome):
    """Penalty for large actions."""
    return -outcome["action"].square().sum(-1, keepdim=True)


def meadow(rng, difficulty):
    return free(rng, difficulty)
