"""What an episode starts from, and what episodes are drawn from, as plain data."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

from modpush.envs.scenes.layouts import SceneFn, get_scene
from modpush.envs.scenes.objects import PushedObject, get_object
from modpush.envs.scenes.obstacle import Obstacle
from modpush.geometry.workspace import BOUNDS_MARGIN, WORKSPACE, Rectangle

__all__ = ["Dynamics", "Scenario", "ScenarioConfig"]


@dataclass(frozen=True, kw_only=True)
class Dynamics:
    """What the agent is not told about the pushed object."""

    mass: float = 1.0
    """Mass of the object [kg]."""
    friction: float = 0.5
    """Friction coefficient of the object's material; a pair's is the mean of both materials'."""
    center_of_mass: tuple[float, float] = (0.0, 0.0)
    """Offset of the centre of mass from the object's origin along its x and y [m]."""


@dataclass(frozen=True, kw_only=True)
class Scenario:
    """An episode's start: layout, object, goal and tool. Base frame, metres and radians."""

    scene: str
    """Name of the scene family, by which `get_scene` finds it again."""
    difficulty: float
    """Difficulty that the layout was made with, in [0, 1]."""
    obstacles: tuple[Obstacle, ...]
    """Layout of the obstacles."""
    pushed_object: str
    """Name of the pushed object."""
    object_pose: tuple[float, float, float]
    """x, y and yaw of the object [m, m, rad]."""
    goal_position: tuple[float, float]
    """x and y of the goal [m]."""
    tool_pose: tuple[float, float, float]
    """x and y of the tool's tip, and its yaw [m, m, rad]."""
    dynamics: Dynamics = field(default_factory=Dynamics)
    """What the agent is not told about the object."""

    def to_dict(self) -> dict[str, Any]:
        """Plain lists, numbers and strings, ready for JSON."""
        return asdict(self)

    @classmethod
    def from_dict(cls, data: dict[str, Any]) -> "Scenario":
        """Inverse of `to_dict`, also after a way through JSON.

        Raises:
            ValueError: If a field is missing or unknown; the message names it.
        """
        data = dict(data)
        expected = set(cls.__dataclass_fields__)
        if set(data) != expected:
            raise ValueError(
                f"Scenario: fields missing {sorted(expected - set(data))}, "
                f"unknown {sorted(set(data) - expected)}."
            )
        obstacles = tuple(Obstacle(tuple(o["size"]), tuple(o["pose"])) for o in data["obstacles"])
        dynamics = dict(data["dynamics"])
        dynamics["center_of_mass"] = tuple(dynamics["center_of_mass"])
        data.update(obstacles=obstacles, dynamics=Dynamics(**dynamics))
        for name in ("object_pose", "goal_position", "tool_pose"):
            data[name] = tuple(data[name])
        return cls(**data)


@dataclass(frozen=True, kw_only=True)
class ScenarioConfig:
    """What to draw episodes from."""

    scene: str | SceneFn | Sequence[str | SceneFn] = "free"
    """Scene family, by name, by `"module:function"` or as a function, or several of them, one of
    which is drawn for each episode."""
    pushed_object: str | PushedObject | Sequence[str | PushedObject] = "small_cube"
    """Pushed object, by name, by `"module:name"` or as a `PushedObject`, or several of them, one of
    which is drawn for each episode."""
    difficulty: float | tuple[float, float] = (0.0, 1.0)
    """Difficulty of the scene in [0, 1], a number or a range drawn from uniformly."""
    distance: float | tuple[float, float] = (0.2, 0.6)
    """Distance from start to goal, a number or a range drawn from uniformly [m]."""
    low: tuple[float, float] = WORKSPACE.low
    """Lower corner of the workspace [m]."""
    high: tuple[float, float] = WORKSPACE.high
    """Upper corner of the workspace [m]."""
    max_start_radius: float = 0.80
    """Largest distance of a start from the robot's axis: beyond, the tool could not stand behind the
    object [m]."""
    max_goal_radius: float = 0.82
    """Largest distance of a goal from the robot's axis [m]."""
    clearance: float = 0.06
    """Least distance of start and goal from obstacles, surface to surface [m]."""
    path_margin: float = 0.04
    """How far out of the workspace the object's way to the goal may lead; at 5 cm an episode ends
    [m]."""
    tool_distance: tuple[float, float] = (0.08, 0.14)
    """Range of the distance from the object's centre to the tool's tip at the start [m]."""
    randomize_dynamics: bool = False
    """Whether mass, friction and centre of mass are drawn anew for each episode."""
    mass: tuple[float, float] = (0.2, 2.0)
    """Range of the mass with randomised dynamics, drawn log-uniformly [kg]."""
    friction: tuple[float, float] = (0.2, 0.8)
    """Range of the friction coefficient of the object's material with randomised dynamics."""
    center_of_mass: float = 0.01
    """Largest offset of the centre of mass along each axis with randomised dynamics [m]."""

    def __post_init__(self) -> None:
        """Check names and ranges, so that nothing fails at the thousandth reset."""
        if not self.scenes:
            raise ValueError("ScenarioConfig: scene is empty, expected at least one family.")
        if not self.objects:
            raise ValueError("ScenarioConfig: pushed_object is empty, expected at least one.")
        names = [item.name for item in self.objects]
        if repeated := sorted({name for name in names if names.count(name) > 1}):
            raise ValueError(
                f"ScenarioConfig: pushed objects must have different names, got {repeated} several "
                "times."
            )
        ranges: dict[str, tuple[tuple[float, float], float, float]] = {
            "difficulty": (self.difficulty_range, 0.0, 1.0),
            "distance": (self.distance_range, 0.0, 2.0),
            "path_margin": ((self.path_margin, self.path_margin), 0.0, 1.0),
            "tool_distance": (self.tool_distance, 0.0, 1.0),
            "mass": (self.mass, 1e-3, 1e3),
            "friction": (self.friction, 0.0, 10.0),
        }
        for name, ((low, high), least, most) in ranges.items():
            if not least <= low <= high <= most:
                raise ValueError(
                    f"ScenarioConfig: {name} must be a range within [{least:g}, {most:g}], "
                    f"got ({low:g}, {high:g})."
                )
        if not all(lo < hi for lo, hi in zip(self.low, self.high, strict=True)):
            raise ValueError(f"ScenarioConfig: low must be < high, got {self.low} and {self.high}.")

    def bounds(self, margin: float = BOUNDS_MARGIN) -> Rectangle:
        """Where the object's centre may be before an episode ends, base frame [m]."""
        return Rectangle(self.low, self.high).bounds(margin)

    @property
    def scenes(self) -> list[tuple[str, SceneFn]]:
        """The families to draw from, by name and function."""
        scene = self.scene
        several: list[Any] = list(scene) if isinstance(scene, list | tuple) else [scene]
        return [get_scene(one) for one in several]

    @property
    def objects(self) -> list[PushedObject]:
        """The objects to draw from."""
        item = self.pushed_object
        several: list[Any] = list(item) if isinstance(item, list | tuple) else [item]
        return [get_object(one) for one in several]

    @property
    def difficulty_range(self) -> tuple[float, float]:
        """Difficulty as a range."""
        return _range(self.difficulty)

    @property
    def distance_range(self) -> tuple[float, float]:
        """Distance from start to goal as a range [m]."""
        return _range(self.distance)


def _range(value: float | tuple[float, float]) -> tuple[float, float]:
    if isinstance(value, int | float):
        return float(value), float(value)
    return value
