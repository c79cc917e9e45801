"""The conditions under which the episodes of a set are run, and how late and exactly a policy sees."""

import json
import math
from collections.abc import Mapping
from dataclasses import asdict, field
from typing import Any, Literal

from modpush._types import (
    Count,
    Frequency,
    Length,
    Name,
    NonNegative,
    NonNegativeLength,
    StepSpan,
    YawTolerance,
)
from modpush._validation import checked, from_plain
from modpush.envs.engines.base import check_engine
from modpush.envs.outcome import GOAL_THRESHOLD, Goal
from modpush.envs.robot.named import check_robot, check_tool
from modpush.envs.scenes.objects import Circle

SensingName = Literal["exact", "noise", "delay", "noise_delay"]


@checked
class SensingConfig:
    """Delays, and noise of the object's pose, between a policy and the world; none by default."""

    action_delay: StepSpan = (0, 0)
    """Lowest and highest age of the action that is executed [control steps], see `ActionDelay`."""
    observation_delay: StepSpan = (0, 0)
    """Lowest and highest age of poses, joint angles, contact flag and images that the policy's
    observation is computed from [control steps], see `ObservationDelay`."""
    position_noise: NonNegativeLength = 0.0
    """Largest error of x and of y of the object [m], uniform and independent in every step."""
    yaw_noise: NonNegative = 0.0
    """Largest error of the object's yaw [rad], uniform and independent in every step."""

    @property
    def noisy(self) -> bool:
        """True if the object's pose has noise."""
        return self.position_noise > 0 or self.yaw_noise > 0

    @property
    def exact(self) -> bool:
        """True if the policy observes the present, true state."""
        return not self.noisy and self.observation_delay == (0, 0)


SENSING: dict[SensingName, SensingConfig] = {
    "exact": SensingConfig(),
    "noise": SensingConfig(position_noise=0.015, yaw_noise=math.radians(7.5)),
    "delay": SensingConfig(action_delay=(1, 3), observation_delay=(1, 1)),
    "noise_delay": SensingConfig(
        position_noise=0.015,
        yaw_noise=math.radians(7.5),
        action_delay=(1, 3),
        observation_delay=(1, 1),
    ),
}
"""Conditions of evaluation by name. Noise and numbers of steps are those with which MuJoCo Playground
trains `PandaRobotiqPushCube` for hardware: actions 1 to 3 steps old, and observations 6 to 12 simulation
steps of 5 ms, 30 to 60 ms, for which one control step of 67 ms stands here. Its steps of actions are of
5 ms, too, so that a delay here is 13 times as long."""

_LATER = (
    "engine",
    "robot",
    "goal",
    "position_tolerance",
    "yaw_tolerance",
    "hold_steps",
    "full_circle",
    "dynamic_obstacles",
    "sensing",
)
"""Fields that were added after the first sets were written."""


@checked
class EpisodeConditions:
    """Time limit, goal, robot, tool, physics and map of a set, whatever a method was made with.

    The fields up to `dynamic_obstacles` are those of `SimulationConfig`, with parts by their names.
    """

    engine: Name = "sapien"
    max_episode_steps: Count = 200
    robot: Name = "ur5"
    tool: Name = "2f85"
    sim_freq: Frequency | None = 120
    goal: Goal = "position"
    position_tolerance: Length = GOAL_THRESHOLD
    yaw_tolerance: YawTolerance = math.radians(10)
    hold_steps: Count = 1
    full_circle: bool = False
    dynamic_obstacles: bool = False
    inflation: Circle = "circumscribed"
    """The object's circle whose radius is that by which obstacles were inflated where it was
    decided that an episode can be solved, and are for its shortest path. With `inscribed` a method plans
    on a map inflated so, since there may be no way on another, unless it chooses the widest inflation
    that leaves a path; with `circumscribed` there is a way on either map, and a method plans on a map of
    its own."""
    sensing: SensingConfig = field(default_factory=SensingConfig)
    """Delays and noise between policy and world; only for agents."""

    def __post_init__(self) -> None:
        check_robot("EpisodeConditions", self.robot)
        check_tool("EpisodeConditions", self.tool)
        check_engine("EpisodeConditions", self.engine)

    @property
    def env_options(self) -> dict[str, Any]:
        """Time limit, goal, robot, tool, engine and its rate, as arguments of `PushEnv`."""
        own = ("inflation", "sensing")
        return {name: value for name, value in asdict(self).items() if name not in own}

    def agent_options(self, inflation: str | float) -> dict[str, Any]:
        """Arguments of `make_push_env`: `env_options`, `sensing` and, for a certain map, `inflation`.

        Args:
            inflation: The agent's own, `PushEnvConfig.inflation`; `"widest"` finds a path on every set.
        """
        own_map = self.inflation == "circumscribed" or inflation == "widest"
        options = {**self.env_options, "sensing": self.sensing}
        return options if own_map else {**options, "inflation": self.inflation}

    def differences(self, simulation: Any) -> dict[str, tuple[Any, Any]]:
        """Differences of an environment: `(there, of the set)` by field.

        Args:
            simulation: `PushEnv.simulation` of the environment.
        """
        return {
            name: (getattr(simulation, name), value)
            for name, value in self.env_options.items()
            if value is not None and getattr(simulation, name) != value
        }

    def to_dict(self) -> dict[str, Any]:
        """Plain data for files, without what older files do not know where it is as it was then."""
        usual = asdict(type(self)())
        changed = {k: v for k, v in asdict(self).items() if k not in _LATER or v != usual[k]}
        plain: dict[str, Any] = json.loads(json.dumps(changed))  # as it is read back
        return plain

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> "EpisodeConditions":
        """Inverse of `to_dict`, also after JSON; a ValueError names a field that is wrong."""
        return from_plain(cls, data)
