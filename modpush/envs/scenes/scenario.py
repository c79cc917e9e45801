"""The start of an episode, and the settings from which starts are drawn, as plain data."""

from collections.abc import Mapping
from dataclasses import asdict, field
from functools import cached_property
from typing import TYPE_CHECKING, Annotated, Any, Literal, TypeAlias

from annotated_types import Ge, Le, MaxLen
from pydantic import BeforeValidator, Strict

from modpush._types import (
    ONE_NUMBER,
    SPAN,
    Angle,
    AtLeastOne,
    Fraction,
    FractionSpan,
    Length,
    Name,
    NonNegative,
    NonNegativeLength,
    Point,
    Pose,
    Positive,
    Several,
)
from modpush._validation import checked, from_plain
from modpush.envs.outcome import GOAL_THRESHOLD
from modpush.envs.robot.control import MotionConfig
from modpush.envs.scenes.layouts import SceneFn, get_scene
from modpush.envs.scenes.objects import Circle, PushedObject, get_object
from modpush.envs.scenes.obstacle import MAX_OBSTACLES, Obstacle
from modpush.geometry.workspace import BOUNDS_MARGIN, WORKSPACE, Rectangle

Mass = Annotated[Positive, Ge(1e-3), Le(1e3)]
"""Mass of an object [kg]."""
Friction = Annotated[NonNegative, Le(10)]
"""Friction coefficient of an object's material."""
GoalDistance = Annotated[Length, Ge(GOAL_THRESHOLD), Le(2)]
"""Distance from start to goal [m]; nearer, an episode has ended before its first step."""
GoalDistances = Annotated[tuple[GoalDistance, GoalDistance], Strict(False), SPAN]
"""Lower and upper end of a range of distances from start to goal [m]."""


def _one_or_more(value: Any) -> Any:
    """A single part as a tuple that holds it."""
    return value if isinstance(value, list | tuple) else (value,)


if TYPE_CHECKING:  # type checkers know of no conversion
    Parts: TypeAlias = Any
    DifficultyRange: TypeAlias = Any
    DistanceRange: TypeAlias = Any
else:
    # Of anything, since the command line gives names, and only Python gives objects.
    Parts = Annotated[AtLeastOne[Any], BeforeValidator(_one_or_more)]
    DifficultyRange = Annotated[FractionSpan, ONE_NUMBER]
    DistanceRange = Annotated[GoalDistances, ONE_NUMBER]


@checked
class Dynamics:
    """Dynamics of the pushed object, which the agent does not observe."""

    mass: Mass = 1.0
    """Mass of the object [kg]."""
    friction: Friction = 0.5
    """Friction coefficient of the object's material; a pair's is the mean of both materials'."""
    center_of_mass: Point = (0.0, 0.0)
    """Offset of the centre of mass from the object's origin along its x and y [m]."""


@checked
class Scenario:
    """An episode's start: layout, object, goal and tool. Base frame, metres and radians."""

    scene: Name
    """Name of the scene family, by which `get_scene` finds it again."""
    difficulty: Fraction
    """Difficulty for which the layout was made, in [0, 1]."""
    obstacles: Annotated[Several[Obstacle], MaxLen(MAX_OBSTACLES)]
    """Layout of the obstacles."""
    pushed_object: Name
    """Name of the pushed object."""
    object_pose: Pose
    """x, y and yaw of the object [m, m, rad]."""
    goal_position: Point
    """x and y of the goal [m]."""
    tool_pose: Pose
    """x and y of the tool's tip, and its yaw [m, m, rad]."""
    dynamics: Dynamics = field(default_factory=Dynamics)
    """Mass, friction and centre of mass of the object, which the agent does not observe."""
    goal_yaw: Angle | None = None
    """Yaw that the object is to have at the goal [rad]; None where the goal is a position."""

    def to_dict(self) -> dict[str, Any]:
        """Plain lists, numbers and strings, ready for JSON; `goal_yaw` only where the goal is a pose."""
        plain = {**asdict(self), "obstacles": tuple(item.to_dict() for item in self.obstacles)}
        return {k: v for k, v in plain.items() if (k, v) != ("goal_yaw", None)}

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> "Scenario":
        """Inverse of `to_dict`, also after JSON; a ValueError names a field that is wrong."""
        return from_plain(cls, data)


@checked
class ScenarioConfig:
    """Settings from which episodes are drawn."""

    scene: Parts = ("free",)
    """Scene families, one of which is drawn for each episode: by name, by `"module:function"` or as
    functions; a single one may be given alone. A curriculum's phases may name others. The preset
    `paper` has the five of the paper's training, which has no empty scene (Sec. IV-B)."""
    pushed_object: Parts = ("small_cube",)
    """Pushed objects, one of which is drawn for each episode: by name, by `"module:name"` or as
    `PushedObject`s; a single one may be given alone. `random_7` has a random shape and size, see
    `random_object`."""
    difficulty: DifficultyRange = (0.0, 1.0)
    """Range from which the difficulty of the scenes is drawn uniformly, in [0, 1]; or a number."""
    distance: DistanceRange = (0.2, 0.6)
    """Range from which the distance from start to goal is drawn uniformly [m]; or a number. By
    default that of the paper's evaluation (Sec. V-B)."""
    low: Point = WORKSPACE.low
    """Lower corner of the workspace, which must lie within the tool's (`MotionConfig`) [m]."""
    high: Point = WORKSPACE.high
    """Upper corner of the workspace [m]."""
    max_start_radius: Length = 0.80
    """Largest distance of a start from the robot's axis [m]; beyond it, the tool could not stand
    behind the object."""
    max_goal_radius: Length = 0.82
    """Largest distance of a goal from the robot's axis [m]."""
    clearance: NonNegativeLength = 0.06
    """Smallest distance of start and goal from obstacles, surface to surface [m]."""
    obstacle_between: bool = False
    """Draw only episodes in which an obstacle stands in the straight way from start to goal; where a
    family places no obstacles, any."""
    path_required: bool = True
    """Draw only episodes in which a path past the obstacles joins start and goal. False: also those in
    which obstacles have to be pushed away, with `dynamic_obstacles`."""
    path_margin: NonNegativeLength = 0.04
    """Largest distance by which the object's path to the goal may leave the workspace [m]; at 5 cm an
    episode ends."""
    path_inflation: Circle | None = None
    """Circle of the object by whose radius obstacles are inflated to decide whether a path to the
    goal exists. With `inscribed`, passages count that the object fits through at some yaw angles
    only. None: in `make_push_env` the circle that is planned with, else `circumscribed`."""
    tool_distance: FractionSpan = (0.08, 0.14)
    """Range of the distance from the object's centre to the tool's tip at the start [m]."""
    tool_start: Literal["any", "behind"] = "any"
    """Start of the tool: in any direction from the object, or 9 cm straight behind it as seen from
    the goal, its wide side towards the object, as in the code of the paper's authors."""
    randomize_dynamics: bool = False
    """Draw mass, friction and centre of mass for each episode."""
    mass: Annotated[tuple[Mass, Mass], Strict(False), SPAN] = (0.2, 2.0)
    """Range of the mass with randomised dynamics, drawn log-uniformly [kg]."""
    friction: Annotated[tuple[Friction, Friction], Strict(False), SPAN] = (0.2, 0.8)
    """Range of the friction coefficient of the object's material with randomised dynamics."""
    center_of_mass: NonNegativeLength = 0.01
    """Largest offset of the centre of mass along each axis with randomised dynamics [m]; at most a
    quarter of the object's side (`PushedObject.sides`), so that it stays over the footprint."""

    def __post_init__(self) -> None:
        """Check names and ranges; `"module:name"` is imported when it is used.

        A config that comes from a file runs no code.
        """
        for parts, look_up in ((self.scene, "scenes"), (self.pushed_object, "objects")):
            if ":" not in "".join(map(str, parts)):
                getattr(self, look_up)
        if self.distance[1] < GOAL_THRESHOLD + 1e-4:  # positions have single precision
            raise ValueError(
                f"ScenarioConfig: distance must reach beyond {GOAL_THRESHOLD} m, at which an episode has "
                f"ended before its first step, got {self.distance}."
            )
        (x0, y0), (x1, y1) = self.low, self.high
        if not (x0 < x1 and y0 < y1):
            raise ValueError(f"ScenarioConfig: low must be < high, got {self.low} and {self.high}.")
        (least_x, least_y), (most_x, most_y) = MotionConfig.low, MotionConfig.high
        if x0 < least_x or y0 < least_y or x1 > most_x or y1 > most_y:
            raise ValueError(
                f"ScenarioConfig: low and high must lie within the tool's workspace, {MotionConfig.low} "
                f"to {MotionConfig.high}, got {self.low} and {self.high}."
            )

    def bounds(self, margin: float = BOUNDS_MARGIN) -> Rectangle:
        """Bounds of the object's centre, outside of which an episode ends, base frame [m]."""
        return Rectangle(self.low, self.high).bounds(margin)

    @cached_property
    def scenes(self) -> list[tuple[str, SceneFn]]:
        """The families to draw from, by name and function."""
        return [get_scene(one) for one in self.scene]

    @cached_property
    def objects(self) -> list[PushedObject]:
        """The objects to draw from.

        Raises:
            ValueError: If two have the same name.
        """
        objects = [get_object(one) for one in self.pushed_object]
        names = [item.name for item in objects]
        if repeated := sorted({name for name in names if names.count(name) > 1}):
            raise ValueError(
                f"ScenarioConfig: pushed objects must have different names, got {repeated} several "
                "times."
            )
        return objects
