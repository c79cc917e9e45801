"""The preset `paper` against the paper's printed numbers, and what the other presets change."""

from dataclasses import asdict, fields
from functools import reduce

import pytest

from modpush.agents import TQCConfig
from modpush.encoders.vae.model import DepthVAE
from modpush.envs.scenes.layouts import OBSTACLE_SCENES
from modpush.mdp import CurriculumConfig, RewardConfig
from modpush.mdp.observation_entries import PAPER_ENTRIES, PATH_AHEAD_ENTRIES
from modpush.recipes.config import PushEnvConfig
from modpush.replay import ReplayConfig
from modpush.training import TRAIN_PRESETS, TrainConfig

PAPER = TRAIN_PRESETS["paper"]

PRINTED = {
    # Sec. IV-A, preprocessing
    "env.window_size": 64,
    "env.encoder": "vae",
    # Sec. IV-B, observation space: the tool in the object's frame, a sub-goal after 20 % of the path
    "env.frame": "object",
    "env.subgoal_mode": "fraction",
    "env.subgoal_fraction": 0.2,
    "env.inflation": "inscribed",  # half of the small cube's diameter
    "env.planner_margin": None,
    "env.subgoal_lags": (1, 5),  # table of observations
    "env.entries": (),
    "env.leave_out": (),
    "env.add": (),
    # Sec. IV-B, action space: point control of the arm
    "env.action_frame": "base",
    # Sec. IV-B, eq. 2 to 5
    "env.reward.weights": {
        "goal": 50,
        "distance": 1,
        "approach": 1,
        "touch": 1,
        "object_collision": 5,
        "out_of_bounds": 10,
    },
    "env.reward.scale": 1,
    "env.reward.normalisation": "initial",
    # Sec. IV-B, RL algorithm, with the defaults of the implementation that the paper names
    "tqc.loss": "tqc",
    "tqc.num_critics": 2,
    "tqc.num_quantiles": 25,
    "tqc.top_quantiles_to_drop_per_net": 2,
    "tqc.alpha_init": 1,
    # Sec. IV-B, attentive experience replay
    "replay.sampler": "attentive",
    "replay.similarity": "cosine",
    "replay.capacity": 1e6,
    "replay.batch_size": 512,
    "tqc.batch_size": 512,
    "replay.k": 4,
    # Sec. IV-B, learning strategy
    "curriculum.phases": ({"scenes": (), "first_stage": 0},),
    "env.scenario.scene": OBSTACLE_SCENES,
    "env.scenario.pushed_object": ("small_cube",),
    "total_steps": 7e6,
    "tqc.updates_per_step": 1,
    # Sec. V
    "env.simulation.tool": "2f85",
    "env.planner": "lazy_theta_star_grid",
    "tqc.hidden_sizes": (512, 256, 128),
    "tqc.exploration_sigma": 0.4,
    "greedy_envs": 0,  # the noise is in all scenes
    # Sec. V-B
    "env.scenario.distance": (0.2, 0.6),
    "curriculum.final_distance": (0.2, 0.6),
    # What this library adds is off.
    "env.path_ahead": (),
    "env.raw": False,
    "env.recovery": False,
    "env.contact_filter": False,
    "env.motion_ahead": 0.0,
    "env.planner_clearance": 0.0,
    "replay.n_steps": 1,
    "actor_average": 0.0,
    "first_actions": "random",
    "mirror": False,
    "env.scenario.randomize_dynamics": False,
    "env.symmetry": None,
    "zero_init_latent": False,
    "init_from": None,
}


def value_of(config, path):
    return reduce(lambda part, name: part[name], path.split("."), asdict(config))


def test_the_preset_is_what_the_paper_prints():
    assert {path: value_of(PAPER, path) for path in PRINTED} == PRINTED


def test_the_observation_has_the_widths_of_the_papers_table():
    widths = {
        "latent": DepthVAE.from_pretrained().latent_dim,
        "ee_pose": 5,
        "joint_position": 6,
        "subgoal_past": 2 * len(PAPER.env.subgoal_lags),
        "contact": 1,
        "goal_distance": 1,
    }
    assert tuple(widths) == PAPER_ENTRIES
    assert (widths["latent"], sum(widths.values())) == (32, 49)


def test_what_is_made_without_arguments_is_the_papers():
    assert TrainConfig() == PAPER
    assert PushEnvConfig() == PushEnvConfig.preset("paper") == PAPER.env
    assert RewardConfig() == PAPER.env.reward
    assert TQCConfig() == TQCConfig.preset("paper") == PAPER.tqc
    assert ReplayConfig() == PAPER.replay
    assert CurriculumConfig() == PAPER.curriculum


def changed(config, base, prefix=""):
    """Paths of the fields in which two configs differ."""
    found = {}
    for field in fields(base):
        one, other = getattr(config, field.name), getattr(base, field.name)
        if hasattr(one, "__dataclass_fields__"):
            found |= changed(one, other, f"{prefix}{field.name}.")
        elif one != other:
            found[f"{prefix}{field.name}"] = one
    return found


def test_all_in_which_the_cpu_preset_departs_from_the_paper():
    departures = changed(TRAIN_PRESETS["cpu"], PAPER)
    assert departures.pop("env.reward.weights") == {
        "goal": 50.0,
        "distance": 1.0,
        "approach": 1.0,
        "touch": 1.0,
        "object_collision": 1.5,
        "tool_collision": 0.5,
        "out_of_bounds": 50.0,
        "window": 0.0,
        "detour": 100.0,
        "no_contact": 1.0,
    }
    phases = departures.pop("curriculum.phases")
    assert [(phase.scenes, phase.first_stage) for phase in phases] == [(("free",), 0), ((), 6)]
    assert departures == {
        "env.num_envs": 16,
        "env.scenario.scene": ("free", *OBSTACLE_SCENES),
        "env.frame": "path",
        "env.action_frame": None,
        "env.planner": "distance_field",
        "env.inflation": "widest",
        "env.planner_margin": 0.02,
        "env.subgoal_mode": "lookahead",
        "env.path_ahead": (0.1, 0.2, 0.3),
        "env.entries": PATH_AHEAD_ENTRIES,
        "env.reward.scale": 0.1,
        "env.reward.normalisation": "constant",
        "env.recovery": True,
        "tqc.hidden_sizes": (256, 256),
        "tqc.actor_lr": 6e-4,
        "tqc.critic_lr": 6e-4,
        "tqc.alpha_lr": 3e-4,
        "tqc.alpha_init": 0.02,
        "tqc.batch_size": 256,
        "tqc.updates_per_step": 1 / 8,
        "tqc.learning_starts": 3000,
        "tqc.precision": "auto",
        "replay.batch_size": 256,
        "replay.n_steps": 3,
        "curriculum.promotion": "off",
        "curriculum.window": 12,
        "first_actions": "scripted",
        "actor_average": 0.999,
        "zero_init_latent": True,
        "mirror": True,
        "total_steps": 500_000,
        "greedy_envs": 4,
    }


@pytest.mark.parametrize("name", ["refine", "any_object", "refine_any_object", "movable"])
def test_presets_with_published_figures_keep_their_updates(name: str) -> None:
    tqc = TRAIN_PRESETS[name].tqc
    assert (tqc.updates_per_step, tqc.actor_lr, tqc.critic_lr) == (1 / 12, 3e-4, 3e-4)
