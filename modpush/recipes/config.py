"""The environment of a pushing agent as one configuration, and its presets."""

from collections.abc import Collection
from dataclasses import field, replace
from pathlib import Path
from typing import Annotated, Any, Literal

from annotated_types import Le

from modpush._types import (
    AtLeastOne,
    Count,
    FractionSpan,
    Name,
    NonNegative,
    PositiveFraction,
    Scenes,
    Several,
)
from modpush._validation import checked
from modpush.encoders import ENCODERS
from modpush.envs.scenes.layouts import OBSTACLE_SCENES, SCENES
from modpush.envs.scenes.objects import OBJECTS
from modpush.envs.scenes.scenario import GoalDistances
from modpush.geometry.frames import Frame
from modpush.mdp.push_reward import RewardConfig
from modpush.parts import part_module
from modpush.planners import PLANNERS
from modpush.planners.subgoals import SubgoalMode

__all__ = ["END_TO_END", "PushEnvConfig"]

END_TO_END = "end_to_end"
"""Name of the encoder that is trained with the agent."""


@checked
class PushEnvConfig:
    """What `make_push_env` stacks on a `PushEnv`: scenes, planner, encoder, observation and reward.

    Parts of your own are given as `"module:name"`.
    """

    num_envs: Scenes = 8
    """Number of scenes stepped together."""
    pushed_object: Name | AtLeastOne[Name] = "small_cube"
    """Name of the pushed object, or several, one of which is drawn for each episode."""
    scene: AtLeastOne[Name] = ("free", *OBSTACLE_SCENES)
    """Scene families, one of which is drawn for each episode. A curriculum's phases may name others."""
    difficulty: FractionSpan = (0.0, 1.0)
    """Range of the scenes' difficulty, drawn from uniformly."""
    distance: GoalDistances = (0.2, 0.6)
    """Range of the distance from start to goal [m]."""
    frame: Frame = "object"
    """Axes in which the agent observes and acts, and of the local window."""
    action_frame: Frame | None = None
    """Axes in which the agent acts, if other than `frame` (the paper: `base`)."""
    encoder: Name = "vae"
    """Encoder of the local window: `vae` (the shipped one), `rays`, `none`, the file of a trained
    `DepthVAE`, or `module:name`. With `end_to_end` the window itself is emitted as bytes, for the
    encoder of the learner (`tqc.encoder`), which is trained with the agent."""
    latent_dim: Annotated[Count, Le(65_536)] | None = None
    """Number of values in the latent, for the encoder `rays`; its default is 32."""
    window_size: Annotated[Count, Le(4096)] = 64
    """Side of the window for `end_to_end` [px]; other encoders say which size they take."""
    window_outside: Literal["free", "blocked"] = "free"
    """What the local window shows beyond the camera's image."""
    planner: Name = "distance_field"
    """Path planner by name, or `module:name`; `distance_field` gives the paths of Lazy Theta*, faster."""
    inflation: Literal["circumscribed", "inscribed"] | NonNegative = "circumscribed"
    """How far obstacles are inflated for planning: the radius of the object's circumscribed or inscribed
    circle, or a distance [m]."""
    subgoal_mode: SubgoalMode = "fraction"
    """How the sub-goal is chosen on the path, see `PlannerSubgoals`."""
    subgoal_fraction: PositiveFraction = 0.2
    """Share of the path's length at which the sub-goal lies, for the mode `fraction`."""
    subgoal_lookahead: NonNegative = 0.2
    """Distance along the path at which the sub-goal lies, for the mode `lookahead` [m]."""
    entries: Several[Name] = ()
    """Entries of the observation in their order, by name or `module:name`; empty takes those of the
    frame."""
    leave_out: Several[Name] = ()
    """Entries of the observation that are left out, for ablations."""
    add: Several[Name] = ()
    """Entries that are added to the observation, by name or `module:name`."""
    reward: RewardConfig = field(default_factory=RewardConfig)
    """Weights, scale and normalisation of the reward. A term of your own is a weight by the name
    `module:name`."""
    raw: bool = False
    """Observe SI units instead of values scaled to order 1."""
    max_episode_steps: Count = 200
    """Control steps after which an episode is truncated."""
    oob: Literal["truncate", "terminate"] = "truncate"
    """What happens when the object leaves the workspace."""
    tool: Literal["2f85", "rod"] = "2f85"
    """Tool of the arm: the closed gripper, or the rod of the authors' code."""
    sim_freq: Annotated[Count, Le(100_000)] = 120
    """Physics steps per second [Hz]."""
    depth: Name = "analytic"
    """Depth camera: `analytic`, `sapien` (rendered), or `module:name`."""
    randomize_dynamics: bool = False
    """Draw the object's mass, friction and centre of mass for each episode."""

    def __post_init__(self) -> None:
        """Check the names of the library's own parts.

        Numbers are checked by the parts that take them, and `"module:name"` is imported when the
        environment is made: a config that comes from a file runs no code.
        """
        objects = (
            self.pushed_object if isinstance(self.pushed_object, tuple) else (self.pushed_object,)
        )
        for name in objects:
            _check_name("pushed_object", name, OBJECTS)
        for name in self.scene:
            _check_name("scene", name, SCENES)
        _check_name("planner", self.planner, PLANNERS)
        if not Path(self.encoder).is_file():
            # An encoder that only a critic can train would stay as it is, random.
            names = {*ENCODERS, END_TO_END} - {"conv"}
            _check_name("encoder", self.encoder, names)
        if self.latent_dim is not None and self.encoder != "rays":
            raise ValueError(
                f"PushEnvConfig: latent_dim is for the encoder 'rays', got {self.latent_dim} with "
                f"{self.encoder!r}."
            )

    @classmethod
    def preset(cls, name: Literal["paper", "cpu"], **overrides: Any) -> "PushEnvConfig":
        """A named set of values, with single fields overridden.

        Args:
            name: `"paper"` observes in the object's frame and acts in the base frame. `"cpu"` does
                both in the path's frame, which is learned in a fraction of the steps.
            **overrides: Fields to set differently.

        Raises:
            ValueError: If there is no such preset.
        """
        if name not in _PRESETS:
            raise ValueError(
                f"PushEnvConfig: preset must be one of {sorted(_PRESETS)}, got {name!r}."
            )
        return replace(cls(**_PRESETS[name]), **overrides)


_PRESETS: dict[str, dict[str, Any]] = {
    "paper": {"frame": "object", "action_frame": "base"},
    "cpu": {
        "frame": "path",
        "subgoal_mode": "lookahead",
        # Milder on collisions than the paper: at its 5 and 2 a young policy stops beside obstacles.
        "reward": RewardConfig(
            normalisation="constant",
            weights={**RewardConfig().weights, "object_collision": 1.5, "tool_collision": 0.5},
        ),
        "num_envs": 16,
    },
}


def _check_name(field_name: str, name: str, known: Collection[str]) -> None:
    if name not in known and part_module(name) is None:
        raise ValueError(
            f"PushEnvConfig: {field_name} must be one of {sorted(known)} or 'module:name'"
            f"{' or a file' if field_name == 'encoder' else ''}, got {name!r}."
        )
