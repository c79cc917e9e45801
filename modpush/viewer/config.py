"""`PlayConfig`: initial settings of the page."""

from typing import Annotated

from pydantic import Field, Strict

from modpush._types import Fraction, Name, NonNegativeInteger, Several
from modpush._validation import checked
from modpush.envs.engines.base import check_engine
from modpush.envs.outcome import Goal
from modpush.envs.robot.named import check_robot, check_tool
from modpush.envs.scenes.layouts import ALL_SCENES
from modpush.envs.scenes.objects import OBJECTS
from modpush.parts import part_module

CONTROL_FREQ = 15
"""Control steps per second of simulated time [Hz]."""


@checked
class PlayConfig:
    """Initial settings of the page, as the options of `modpush play --help` explain them.

    All but the address can be changed on it.
    """

    policy: Annotated[tuple[Name, ...], Strict(False), Field(min_length=1, max_length=2)] = (
        "agent",
    )
    scene: Name = "slot"
    pushed_object: Name = "small_cube"
    difficulty: Fraction = 0.3
    goal: Goal = "position"
    engine: Name | None = None
    robot: Name | None = None
    tool: Name | None = None
    seed: NonNegativeInteger = 0
    paused: bool = False
    host: Name = "127.0.0.1"
    port: Annotated[int, Field(ge=0, le=65535)] = 8080
    allow: Several[Name] = ()

    def __post_init__(self) -> None:
        """Check the names."""
        if self.engine is not None:
            check_engine("PlayConfig", self.engine)
        if self.robot is not None:
            check_robot("PlayConfig", self.robot)
        if self.tool is not None:
            check_tool("PlayConfig", self.tool)
        for name, value, known in (
            ("scene", self.scene, ALL_SCENES),
            ("pushed_object", self.pushed_object, {*OBJECTS}),
        ):
            if value not in known and (name != "scene" or part_module(value) is None):
                raise ValueError(
                    f"PlayConfig: {name} must be one of {sorted(known)}, got {value!r}."
                )
