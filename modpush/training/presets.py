"""Named training configurations."""

import math
from dataclasses import replace

from modpush.agents.tqc.config import TQCConfig
from modpush.envs.scenes.shape_layouts import SHAPE_SCENES
from modpush.evaluation.set_recipes import HIDDEN_SHAPES, POSE_OBJECTS
from modpush.mdp.curriculum import CurriculumConfig, Phase
from modpush.mdp.observation_entries import PAPER_ENTRIES, POSE_ENTRIES
from modpush.recipes.config import PushEnvConfig
from modpush.replay.config import ReplayConfig
from modpush.training.config import TrainConfig

_NO_CURRICULUM = CurriculumConfig(
    phases=(Phase(scenes=("free",)), Phase(first_stage=6)), window=12, promotion="off"
)
"""All scenes and distances from the beginning. `promotion="success"` alone gives a curriculum that begins
in free space. With the scripted pusher's transitions to learn from, nearly all episodes of most stages
succeed, so that few have to be counted."""


_REFINED_WEIGHTS = {
    "object_collision": 8.0,
    "tool_collision": 4.0,
    "no_contact": 6.0,
    "detour": 400.0,
}
"""Weights that are higher in further training than in `PushEnvConfig.preset("cpu")`."""


_SHIPPED_TQC = TQCConfig.preset("cpu", updates_per_step=1 / 12, learning_starts=10_000)
"""Pace and learning rates of the shipped agents for positions; `cpu` has been tuned again."""


def _cpu() -> TrainConfig:
    return TrainConfig(
        env=PushEnvConfig.preset("cpu"),
        tqc=TQCConfig.preset("cpu", actor_lr=6e-4, critic_lr=6e-4),
        replay=ReplayConfig(batch_size=256, n_steps=3),
        # The scripted pusher's transitions show what reaching the goal is worth, so that no easy episodes
        # are needed; and a policy that has only pushed in free space learns anew among obstacles.
        curriculum=_NO_CURRICULUM,
        first_actions="scripted",
        actor_average=0.999,
        zero_init_latent=True,
        mirror=True,
        total_steps=500_000,
        greedy_envs=4,
    )


def _any_object() -> TrainConfig:
    cpu = _cpu()
    shapes = ("small_cube", "large_cube", "small_cylinder", "fragment")
    return replace(
        cpu,
        env=cpu.env.with_fields(
            pushed_object=(*shapes, *(f"random_{k}" for k in range(1, 9))),
            add=("object_support",),
            randomize_dynamics=True,
        ),
        tqc=_SHIPPED_TQC,
        evaluate_every=50_000,
        evaluation_episodes=144,  # twelve objects, drawn for each episode
    )


def _movable() -> TrainConfig:
    """The small cube among boxes that can be pushed away. docs/results/tracks.md has its figures."""
    cpu = _cpu()
    return replace(
        cpu,
        env=cpu.env.with_fields(
            scene=("free", "movable_4", "movable_8", "movable_12"),
            dynamic_obstacles=True,
            path_required=False,
            planner="through_obstacles",
        ),
        tqc=_SHIPPED_TQC,
        total_steps=150_000,
        evaluate_every=50_000,
    )


def _refine(first: TrainConfig, run: str, learning_starts: int) -> TrainConfig:
    """Further training of a run with a reward that asks for more contact, less collision and detour.

    A policy that cannot push yet does not learn with it, or only late: it stops beside obstacles.
    """
    reward = first.env.reward
    weights = {**reward.weights, **_REFINED_WEIGHTS}
    return replace(
        first,
        env=replace(first.env, reward=replace(reward, weights=weights)),
        init_from=run,
        # Critics that have learned with other rewards are led astray by a buffer of few episodes.
        tqc=replace(_SHIPPED_TQC, learning_starts=learning_starts),
        total_steps=500_000,
        evaluate_every=25_000,
    )


def _paper_cpu() -> TrainConfig:
    """The paper's 49 values, planner, sub-goals, replay, curriculum and penalties, on two cores.

    docs/results/training.md says what each of the departures does.
    """
    paper = PushEnvConfig.preset("paper")
    return TrainConfig(
        env=paper.with_fields(
            num_envs=16,
            # One behaviour instead of one for each direction. Nothing is learned without it.
            frame="path",
            action_frame=None,
            entries=PAPER_ENTRIES,
            inflation="widest",
            planner_margin=0.02,
            reward=replace(paper.reward, scale=0.1, clip=False),
            recovery=True,
        ),
        tqc=TQCConfig.preset("cpu", learning_starts=10_000),
        replay=ReplayConfig(batch_size=256, n_steps=3),
        curriculum=CurriculumConfig(window=12),
        first_actions="scripted",
        actor_average=0.999,
        zero_init_latent=True,
        # Noise frees a policy that stands still; scenes without it show the critics what that is worth.
        greedy_envs=4,
        total_steps=1_000_000,
    )


_YAW_TOLERANCES = (*(math.radians(95) * 0.88**k for k in range(18)), math.radians(10))
"""From 95 degrees, where any yaw of an object with two sides alike is good, to 10."""


def _pose() -> TrainConfig:
    """Goal poses in free space, for an oblong object. docs/results/poses.md says what each part does."""
    cpu = _cpu()
    weights = {
        "goal": 50.0,
        "pose_progress": 250.0,
        "approach": 1.0,
        "touch": 1.0,
        "out_of_bounds": 50.0,
    }
    return replace(
        cpu,
        env=cpu.env.with_fields(
            scene=("free",),
            pushed_object="box",
            goal="pose",
            position_tolerance=0.015,
            yaw_tolerance=_YAW_TOLERANCES[-1],
            entries=POSE_ENTRIES,
            reward=replace(cpu.env.reward, weights=weights),
        ),
        tqc=TQCConfig.preset(
            "cpu", hidden_sizes=(128, 128), updates_per_step=1 / 10, learning_starts=8000
        ),
        replay=ReplayConfig(batch_size=256, n_steps=3, sampler="uniform"),
        # A policy that stands still is found by noise, so that all scenes count.
        greedy_envs=0,
        curriculum=CurriculumConfig(
            promotion="off", yaw_tolerances=_YAW_TOLERANCES, threshold=0.6, window=60
        ),
        hindsight=True,
        total_steps=200_000,
        evaluate_every=25_000,
        evaluation_episodes=100,
    )


def _pose_any_object() -> TrainConfig:
    """Goal poses in free space for the shapes and dynamics of the set `hidden_dynamics`."""
    pose = _pose()
    return replace(
        pose,
        env=pose.env.with_fields(
            pushed_object=HIDDEN_SHAPES,
            encoder="none",  # nothing but the object is on the table
            # In the entries and not in `add`, which is for what an agent knows of the dynamics.
            entries=(*POSE_ENTRIES, "object_support", "object_symmetry"),
            randomize_dynamics=True,
            mass=(0.25, 4.0),
            friction=(0.1, 0.9),
            center_of_mass=0.025,  # a quarter of the longest side
        ),
        total_steps=200_000,
        evaluate_every=50_000,
        evaluation_episodes=96,
    )


def _pose_obstacles() -> TrainConfig:
    """Goal poses past one or two obstacles that stand or move, and in free space, from the beginning."""
    pose = _pose()
    weights = {**pose.env.reward.weights, "object_collision": 4.0, "tool_collision": 4.0}
    return replace(
        pose,
        env=pose.env.with_fields(
            scene=("free", *SHAPE_SCENES),
            pushed_object=POSE_OBJECTS,
            entries=(*POSE_ENTRIES, "object_support", "object_symmetry"),
            obstacle_motion=True,
            add=("obstacle_motion",),
            contact_filter=True,
            motion_ahead=2.0,
            planner_clearance=0.015,
            reward=replace(pose.env.reward, weights=weights),
        ),
        tqc=replace(pose.tqc, hidden_sizes=(256, 256), layer_norm=True),
        actor_average=0.9998,
        total_steps=500_000,
        evaluate_every=50_000,
        evaluation_episodes=96,
    )


def _smoke() -> TrainConfig:
    cpu = _cpu()
    return replace(
        cpu,
        env=cpu.env.with_fields(
            num_envs=2, max_episode_steps=20, encoder="rays", scene=("free", "posts")
        ),
        tqc=replace(cpu.tqc, hidden_sizes=(16,), batch_size=16, learning_starts=64),
        replay=ReplayConfig(batch_size=16, capacity=10_000),
        curriculum=CurriculumConfig(
            phases=(Phase(scenes=("free",)), Phase(first_stage=10)),
            window=4,
        ),
        actor_average=0.9,
        first_actions="scripted",
        mirror=False,  # so that it runs with any parts
        total_steps=480,
        greedy_envs=1,
        evaluate_every=240,
        evaluation_episodes=4,
        log_every=48,
        checkpoint_every=160,
        async_collection=False,
        progress=False,
    )


TRAIN_PRESETS: dict[str, TrainConfig] = {
    "cpu": _cpu(),
    "any_object": _any_object(),
    "movable": _movable(),
    "refine": _refine(_cpu(), "runs/train_cpu", 10_000),
    "refine_any_object": _refine(_any_object(), "runs/train_any_object", 50_000),
    "paper": TrainConfig(env=PushEnvConfig.preset("paper"), tqc=TQCConfig.preset("paper")),
    "paper_cpu": _paper_cpu(),
    "pose": _pose(),
    "pose_any_object": _pose_any_object(),
    "pose_obstacles": _pose_obstacles(),
    "smoke": _smoke(),
}
"""Configuration of each preset by name; `modpush train --help` says what each is for."""
