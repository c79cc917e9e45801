"""`TQCConfig`: presets and ranges."""

import inspect
from dataclasses import fields, replace

import pytest

from modpush.agents import TQCConfig
from modpush.replay import ReplayConfig


@pytest.mark.parametrize("name", ["paper", "cpu"])
def test_presets_take_overrides(name):
    preset = TQCConfig.preset(name)
    assert TQCConfig.preset(name, gamma=0.9) == replace(preset, gamma=0.9)


def test_what_the_paper_leaves_open_is_as_in_its_authors_code():
    config = TQCConfig()
    assert (config.gamma, config.tau, config.learning_starts) == (0.98, 0.005, 10_000)
    assert (config.actor_lr, config.critic_lr, config.alpha_lr) == (1e-4, 1e-4, 1e-4)
    assert (config.min_alpha, config.max_alpha, config.target_entropy) == (None, None, "auto")
    assert not any((config.layer_norm, config.fixed_alpha, config.skip_done_states))
    assert ReplayConfig().gamma == config.gamma  # of n-step returns: must be the loss's


def test_every_field_is_documented():
    source = inspect.getsource(TQCConfig)
    for field in fields(TQCConfig):
        line = source.split(f"    {field.name}: ")[1].split("\n")[1]
        assert line.strip().startswith('"""'), field.name
