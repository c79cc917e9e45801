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


def test_the_defaults_are_the_paper_s_preset():
    assert TQCConfig.preset("paper") == TQCConfig()


def test_what_the_paper_leaves_open_is_as_in_its_authors_code():
    config = TQCConfig()
    assert (config.gamma, config.tau, config.learning_starts) == (0.98, 0.005, 10_000)
    assert (config.actor_lr, config.critic_lr, config.alpha_lr) == (1e-4, 1e-4, 1e-4)
    assert (config.min_alpha, config.max_alpha, config.target_entropy) == (None, None, "auto")
    assert not any((config.layer_norm, config.fixed_alpha, config.skip_done_states))
    assert ReplayConfig().gamma == config.gamma  # of n-step returns: must be the loss's


def test_an_unknown_preset_lists_those_there_are():
    with pytest.raises(ValueError, match=r"must be one of \['cpu', 'paper'\], got 'tpu'."):
        TQCConfig.preset("tpu")


def test_every_field_is_documented():
    source = inspect.getsource(TQCConfig)
    for field in fields(TQCConfig):
        line = source.split(f"    {field.name}: ")[1].split("\n")[1]
        assert line.strip().startswith('"""'), field.name


@pytest.mark.parametrize(
    ("kwargs", "message"),
    [
        (
            {"num_quantiles": 3, "top_quantiles_to_drop_per_net": 3},
            r"top_quantiles_to_drop_per_net must be < num_quantiles \(3\), got 3.",
        ),
        ({"min_alpha": 2.0}, "alpha_init must lie between min_alpha and max_alpha, got 2.0 <= 1.0"),
    ],
)
def test_bad_configs(kwargs, message):
    with pytest.raises(ValueError, match=message):
        TQCConfig(**kwargs)
