"""Entries and terms of a user's own module, for tests that give them as `"module:name"`."""

from modpush.mdp import Entry


def speed(inputs):
    return inputs["speed"]


def gap(inputs):
    return inputs.goal - inputs.subgoal


halved_gap = Entry(gap, 0.5)


def effort(outcome):
    """Penalty for large actions."""
    return -outcome["action"].square().sum(-1, keepdim=True)
