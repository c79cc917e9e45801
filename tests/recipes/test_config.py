import json
from dataclasses import asdict

import pytest

from modpush._validation import from_plain
from modpush.recipes import make_push_env
from modpush.recipes.config import PushEnvConfig


def test_unknown_names_are_answered_with_what_there_is():
    with pytest.raises(ValueError, match=r"encoder must be one of .*'rays'.* got 'eyes'"):
        PushEnvConfig(encoder="eyes")
    with pytest.raises(ValueError, match=r"planner must be one of .*'a_star'.* got 'luck'"):
        PushEnvConfig(planner="luck")
    with pytest.raises(ValueError, match=r"pushed_object must be one of .* got 'duck'"):
        PushEnvConfig(pushed_object="duck")
    with pytest.raises(ValueError, match="preset must be one of"):
        PushEnvConfig.preset("gpu")


def test_a_subgoal_at_the_object_is_refused_before_an_environment_is_made():
    with pytest.raises(ValueError, match=r"subgoal_lookahead must be > 0, got 0"):
        PushEnvConfig(subgoal_lookahead=0.0)


def test_a_config_survives_json():
    config = PushEnvConfig.preset("cpu")
    assert from_plain(PushEnvConfig, json.loads(json.dumps(asdict(config)))) == config


def test_a_config_with_an_unknown_field_is_refused():
    with pytest.raises(ValueError, match=r"PushEnvConfig: .*colour"):
        from_plain(PushEnvConfig, {"colour": "red"})


def test_a_part_of_ones_own_is_not_imported_by_a_config():
    """A config may come from a file, and a file must not decide what code is run."""
    config = PushEnvConfig(
        encoder="no_such_module:Encoder", planner="no_such_module:plan", scene=("no_such_module:s",)
    )
    with pytest.raises(ValueError, match="cannot import 'no_such_module'"):
        make_push_env(config)


def test_an_encoder_that_nothing_would_train_is_refused():
    with pytest.raises(ValueError, match=r"encoder must be one of .*'end_to_end'.* got 'conv'"):
        PushEnvConfig(encoder="conv")


def test_a_range_may_be_given_as_a_number():
    config = PushEnvConfig(difficulty=0.5, distance=1)
    assert (config.difficulty, config.distance) == ((0.5, 0.5), (1.0, 1.0))
    with pytest.raises(ValueError, match=r"difficulty must be a range \(low, high\), got \(1, 0\)"):
        PushEnvConfig(difficulty=(1, 0))
    with pytest.raises(
        ValueError, match=r"distance must be a range \(low, high\), got \(0.6, 0.2\)"
    ):
        PushEnvConfig(distance=(0.6, 0.2))
    with pytest.raises(ValueError, match=r"distance must reach beyond 0.05 m"):
        PushEnvConfig(distance=0.05)
    with pytest.raises(ValueError, match="PushEnvConfig: difficulty must be"):
        PushEnvConfig(difficulty=True)


def test_a_single_scene_may_be_given_as_text():
    assert PushEnvConfig(scene="slot") == PushEnvConfig(scene=("slot",))
    with pytest.raises(ValueError, match=r"scene must be one of .*'slot'.* got 'slit'"):
        PushEnvConfig(scene="slit")


def test_a_latent_size_is_for_rays():
    with pytest.raises(ValueError, match="latent_dim is for the encoder 'rays', got 8 with 'vae'"):
        PushEnvConfig(latent_dim=8)
