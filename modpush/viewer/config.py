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
    """Initial settings of the page; all but the address can be changed on it."""

    policy: Annotated[tuple[Name, ...], Strict(False), Field(min_length=1, max_length=2)] = (
        "agent",
    )
    """One policy, or two that are shown side by side on the same scene: agent (the shipped one),
    corridor, corridor_faithful, scripted, hand, a shipped agent's name, an agent's file, a training
    run's folder, or hf://owner/name."""
    scene: Name = "slot"
    """Scene family from which episodes are drawn: by name, or `module:name` of your own."""
    pushed_object: Name = "small_cube"
    """Name of the pushed object."""
    difficulty: Fraction = 0.3
    """Difficulty of the scenes, 0 to 1."""
    goal: Goal = "position"
    """Kind of the goals: a position of the object's centre, or a pose of the object."""
    engine: Name | None = None
    """Physics engine: `sapien`, `mujoco`, or `module:name`; by default that in which an agent was
    trained, and SAPIEN for other policies."""
    robot: Name | None = None
    """Arm: its name, or `module:name`; by default that with which an agent was trained, and the UR5 for
    other policies."""
    tool: Name | None = None
    """Tool of the arm: `2f85`, `rod`, or `module:name`; by default that with which an agent was trained,
    and the gripper `2f85` for other policies."""
    seed: NonNegativeInteger = 0
    """Seed of the first episode."""
    paused: bool = False
    """Start paused."""
    host: Name = "127.0.0.1"
    """Address to listen on; the default can be reached from this machine only. The page has no
    password: anyone who reaches it can use it."""
    port: Annotated[int, Field(ge=0, le=65535)] = 8080
    """Port to listen on; if it is taken, the next free one is used and printed."""
    allow: Several[Name] = ()
    """Modules from which the file of an agent or a run may import its author's own parts."""

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
