"""The environment of a pushing agent as one configuration, and its presets."""

import functools
from collections.abc import Callable
from dataclasses import field, fields, replace
from typing import Annotated, Any, Literal, TypeVar

from annotated_types import Le

from modpush._types import (
    AtLeastOne,
    Count,
    Name,
    NonNegative,
    NonNegativeInteger,
    Positive,
    PositiveFraction,
    Scenes,
    Several,
)
from modpush._validation import checked
from modpush.encoders import ENCODERS
from modpush.encoders.encode import names_a_file
from modpush.envs.scenes.conditions import SensingConfig
from modpush.envs.scenes.layouts import OBSTACLE_SCENES
from modpush.envs.scenes.objects import Circle
from modpush.envs.scenes.scenario import ScenarioConfig
from modpush.envs.set_fields import set_fields
from modpush.envs.simulation_config import SimulationConfig
from modpush.geometry.frames import Frame
from modpush.mdp.observation_entries import PATH_AHEAD_ENTRIES
from modpush.mdp.push_reward import RewardConfig
from modpush.parts import check_part
from modpush.planners import PLANNERS
from modpush.planners.subgoals import SubgoalMode

T = TypeVar("T")

END_TO_END = "end_to_end"
"""Name of the encoder that is trained with the agent."""


def _accept_single_fields(cls: type[T]) -> type[T]:
    """Let the constructor take fields of `scenario`, `simulation` and `sensing` one by one."""
    as_any: Any = cls
    init, own = as_any.__init__, {field.name for field in fields(as_any)}
    nested: dict[str, Callable[[], Any]]
    nested = {
        "scenario": _default_scenario,
        "simulation": SimulationConfig,
        "sensing": SensingConfig,
    }

    @functools.wraps(init)
    def init_with_fields(self: Any, **given: Any) -> None:
        single = {name: given.pop(name) for name in [*given] if name not in own}
        if single:
            whole = [given.get(name) or make() for name, make in nested.items()]
            changed = set_fields(cls.__name__, single, *whole, also=own)
            given |= dict(zip(nested, changed, strict=True))
        init(self, **given)

    as_any.__init__ = init_with_fields
    return cls


def _default_scenario() -> ScenarioConfig:
    return ScenarioConfig(scene=OBSTACLE_SCENES)


@_accept_single_fields
@checked
class PushEnvConfig:
    """Settings of `make_push_env`: scenes, planner, encoder, observation and reward.

    The defaults are the paper's. Where the paper gives no value, or a default differs from it, the
    field's description says so. Your own parts are given as `"module:name"`, or as objects to
    `make_push_env`. The constructor and `dataclasses.replace` also take fields of `scenario`,
    `simulation` and `sensing` one by one: `PushEnvConfig(scene="slot", tool="rod")`.
    """

    num_envs: Scenes = 8
    """Number of scenes stepped together, which share the cost of a call. The paper gives no number;
    the authors' code steps one."""
    scenario: ScenarioConfig = field(default_factory=_default_scenario)
    """Settings from which episodes are drawn: scenes, objects, difficulty, distance, ..."""
    simulation: SimulationConfig = field(default_factory=SimulationConfig)
    """Tool, depth camera, physics and ends of episodes."""
    sensing: SensingConfig = field(default_factory=SensingConfig)
    """Delays and noise between policy and world; none by default."""
    frame: Frame = "object"
    """Axes of the observation and of the local window."""
    action_frame: Frame | None = "base"
    """Axes of the actions; None for those of the observation."""
    encoder: Name = "vae"
    """Encoder of the local window: `vae` (the shipped one), `rays`, `none`, the file of a trained
    `DepthVAE`, or `module:name`. With `end_to_end` the window itself is emitted as bytes, for the
    encoder of the learner (`tqc.encoder`), which is trained with the agent."""
    latent_dim: Annotated[Count, Le(65_536)] | None = None
    """Number of values in the latent, only for the encoder `rays`, whose default is 32."""
    window_size: Annotated[Count, Le(4096)] = 64
    """Side of the window for `end_to_end` [px]; other encoders define their own size."""
    window_outside: Literal["free", "blocked"] = "free"
    """Content of the local window beyond the camera's image."""
    planner: Name = "lazy_theta_star_grid"
    """Path planner by name, or `module:name`. `lazy_theta_star_grid` is Lazy Theta* as published;
    `distance_field` finds the shortest paths and is faster; `through_obstacles` crosses what can be
    pushed away."""
    inflation: Literal["circumscribed", "inscribed", "widest"] | NonNegative = "inscribed"
    """Distance by which obstacles are inflated for planning: the radius of the object's circumscribed or
    inscribed circle, by the larger of the two that leaves a path ("widest"), or by a distance [m].
    The paper inflates by half of the object's diameter, which its authors' code takes as half the
    cube's side, the radius of its inscribed circle. At other yaw angles a corner may then touch an
    obstacle."""
    planner_clearance: NonNegative = 0.0
    """Distance by which obstacles are inflated more for planning while that leaves a path [m]. The paper
    has none."""
    planner_margin: NonNegative | None = None
    """Distance by which planned paths may leave the workspace [m]. Where this leaves no path, the limit
    is `scenario.path_margin`, within which every drawn episode has one. None lets paths lead
    wherever the camera sees (the paper), also where an episode ends."""
    motion_ahead: NonNegative = 0.0
    """Duration for which the way of the nearest obstacle that moves by itself counts as blocked for the
    planner (`SweptObstacles`) [s]; 0 for its place alone. The obstacle is expected to turn round at the
    workspace's edge. It needs `simulation.obstacle_motion`."""
    plan_poses: bool = False
    """Also plan the object's pose to a goal pose, on its footprint (`PoseField`), and emit
    `pose_path_length`, `subgoal_pose`, `pose_path_found` and, at the distances `path_ahead`,
    `pose_path_ahead`, see `PoseSubgoals`. Only for `goal="pose"`. The axes of the path's frame stay those
    of `planner`, whose path has no yaw."""
    subgoal_lags: AtLeastOne[NonNegativeInteger] = (1, 5)
    """Ages of the past sub-goals that are observed [steps]. The paper's table of observations has 1
    and 5, its text 0 and 1; its authors' code follows the table."""
    subgoal_mode: SubgoalMode = "fraction"
    """Rule by which the sub-goal is chosen on the path, see `PlannerSubgoals`."""
    subgoal_fraction: PositiveFraction = 0.2
    """Share of the path's length at which the sub-goal lies, for the mode `fraction`."""
    subgoal_lookahead: Positive = 0.2
    """Distance along the path at which the sub-goal lies, for the mode `lookahead` [m]."""
    path_ahead: Several[Positive] = ()
    """Distances along the path of the points for the entry `path_ahead` [m]. Unlike the sub-goal,
    these points may lie beyond the next corner."""
    entries: Several[Name] = ()
    """Entries of the observation in order, by name or `module:name`; empty for the default entries
    of the frame. Without an encoder they do not include `latent`."""
    leave_out: Several[Name] = ()
    """Entries to leave out of the observation, for ablations."""
    add: Several[Name] = ()
    """Entries to add to the observation, by name or `module:name`."""
    symmetry: NonNegativeInteger | None = None
    """Number of yaw angles at which every object is taken to look the same in the observation; None
    uses each object's own number. An agent that was trained with one object keeps that object's
    number."""
    reward: RewardConfig = field(default_factory=RewardConfig)
    """Weights, scale and normalisation of the reward. The weight of your own term has the name
    `module:name`."""
    raw: bool = False
    """Observe SI units instead of values scaled to order 1. The paper mentions no scaling, and its
    authors' code has none. With SI units the angles, of some radians, would decide the cosine by
    which attentive replay chooses."""
    recovery: bool = False
    """Append `StuckRecovery`, which `Agent.policy` follows when tool and object have come to rest
    before the goal. Training ignores this field: neither its scenes nor its held-out episodes have
    the recovery. The paper has nothing like it."""
    contact_filter: bool = False
    """Replace actions after which tool or pushed object are predicted to touch an obstacle, or the object
    to leave the workspace, by the nearest ones after which they are not (`ContactFilter`), in training
    as well. With `simulation.obstacle_motion` it also pushes the object out of a moving obstacle's way in
    time. It reads what the agent observes. The paper has nothing like it."""

    def __post_init__(self) -> None:
        """Check the names of the library's own parts.

        Numbers are checked by the parts that take them, and `"module:name"` is imported when the
        environment is made: a config that comes from a file runs no code.
        """
        check_part("PushEnvConfig: planner", self.planner, PLANNERS)
        # A file is read when the environment is made. An encoder that only a critic can train would
        # stay as it is, random.
        names = {*ENCODERS, END_TO_END} - {"conv"}
        if self.encoder == "conv" or not names_a_file(self.encoder):
            other = "'module:name' or a file"
            check_part("PushEnvConfig: encoder", self.encoder, names, other=other)
        if self.plan_poses and self.simulation.goal != "pose":
            raise ValueError(
                f"PushEnvConfig: plan_poses needs goal='pose', got {self.simulation.goal!r}."
            )
        if self.motion_ahead > 0 and not self.simulation.obstacle_motion:
            raise ValueError(
                "PushEnvConfig: motion_ahead needs obstacle_motion=True, got "
                f"motion_ahead={self.motion_ahead:g} without it."
            )
        if self.latent_dim is not None and self.encoder != "rays":
            raise ValueError(
                f"PushEnvConfig: latent_dim is for the encoder 'rays', got {self.latent_dim} with "
                f"{self.encoder!r}."
            )

    @property
    def acting_frame(self) -> Frame:
        """Axes of the actions."""
        return self.frame if self.action_frame is None else self.action_frame

    @property
    def path_inflation(self) -> Circle:
        """Circle of the object for which every episode that is drawn has a path.

        The inscribed one where that is planned with: episodes are solvable on the planner's map.
        """
        if self.scenario.path_inflation is not None:
            return self.scenario.path_inflation
        return "inscribed" if self.inflation in ("inscribed", "widest") else "circumscribed"

    def filled_scenario(self) -> ScenarioConfig:
        """`scenario` with the circle that `path_inflation` says."""
        return replace(self.scenario, path_inflation=self.path_inflation)

    def with_fields(self, **changes: Any) -> "PushEnvConfig":
        """The same with single fields replaced, also those of `scenario`, `simulation` and `sensing`.

        Raises:
            TypeError: If there is no such field; the message lists those that there are.
        """
        return replace(self, **changes) if changes else self

    @classmethod
    def preset(cls, name: Literal["paper", "authors", "cpu"], **overrides: Any) -> "PushEnvConfig":
        """A named set of values, with single fields overridden.

        Args:
            name: `"paper"` is what the paper prints, and what the class gives without arguments.
                `"authors"` is what the authors' code does where it differs from the paper. `"cpu"`
                is the basis of the shipped agents' environments, learned in some tens of minutes.
            **overrides: Fields to set differently, as in `with_fields`.

        Raises:
            TypeError: If there is no such field.
            ValueError: If there is no such preset.
        """
        if not isinstance(name, str) or name not in _PRESETS:
            raise ValueError(
                f"PushEnvConfig: preset must be one of {sorted(_PRESETS)}, got {name!r}."
            )
        return cls(**{**_PRESETS[name], **overrides})


_PRESETS: dict[str, dict[str, Any]] = {
    "paper": {},
    # Not followed, since they are faults or of another kind: a planner that may cross obstacles, a test
    # for leaving the workspace that never holds, a time limit that ends an episode's value, and the -2
    # taking the place of the -5 of the same step.
    "authors": {
        "num_envs": 1,
        "scene": ("free", *OBSTACLE_SCENES),
        "distance": (0.3, 0.6),
        "inflation": 0.0249,  # 7 pixels, whatever the object
        "subgoal_mode": "lookahead",
        "raw": True,
        "tool": "rod",
        "sim_freq": 240,
        "reward": RewardConfig(
            clip=False,
            weights={**RewardConfig().weights, "tool_collision": 2.0, "window": 2.0},
        ),
    },
    "cpu": {
        "num_envs": 16,
        "scene": ("free", *OBSTACLE_SCENES),
        # Going behind the object and pushing it is one behaviour, instead of one for each direction.
        "frame": "path",
        "action_frame": None,
        "planner": "distance_field",  # the shortest paths, in a fraction of the time
        "inflation": "widest",  # room for the object at any yaw, wherever that leaves a path
        "planner_margin": 0.02,  # paths stay away from where an episode ends, if they can
        "subgoal_mode": "lookahead",  # no sub-goal beyond a corner, nor at the object's centre
        "path_ahead": (0.1, 0.2, 0.3),  # where the path turns, before the object is at the corner
        "entries": PATH_AHEAD_ENTRIES,  # without the arm's joints, which are not symmetric
        "reward": RewardConfig(
            scale=0.1,  # rewards of order 1, but for the goal's
            normalisation="constant",  # the same for short and long pushes
            weights={
                "goal": 50.0,
                "distance": 1.0,
                "approach": 1.0,
                "touch": 1.0,
                # Milder than the paper's 5: a young policy would stop beside obstacles.
                "object_collision": 1.5,
                "tool_collision": 0.5,
                "out_of_bounds": 50.0,  # with 10, most failures with the fragment left it
                "window": 0.0,
                "detour": 100.0,
                "no_contact": 1.0,
            },
        ),
        "recovery": True,  # most of what a greedy policy fails in tight scenes ends at rest
    },
}
