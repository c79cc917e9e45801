"""The conditions under which the episodes of a set are run, the same for every method."""

from collections.abc import Mapping
from dataclasses import asdict
from typing import Annotated, Any

from annotated_types import Le

from modpush._types import Count, Name
from modpush._validation import checked, from_plain
from modpush.envs.engines.named import check_engine
from modpush.envs.robot.named import check_robot, check_tool
from modpush.envs.scenes.objects import Circle

__all__ = ["EpisodeConditions"]


@checked
class EpisodeConditions:
    """Time limit, robot, tool, physics and map of an evaluation set, whatever a method was made with."""

    engine: Name = "sapien"
    """Physics engine: `sapien`, `mujoco`, or your own as `module:name`."""

    max_episode_steps: Count = 200
    """Control steps after which an episode is truncated."""
    robot: Name = "ur5"
    """Arm: its name, or your own as `module:name`."""
    tool: Name = "2f85"
    """Tool of the arm: the closed gripper `2f85`, the `rod` of the authors' code, or your own as
    `module:name`."""
    sim_freq: Annotated[Count, Le(100_000)] | None = 120
    """Physics steps per second [Hz]; None for the engine's own."""
    inflation: Circle = "circumscribed"
    """The object's circle whose radius is that by which obstacles were inflated where it was
    decided that an episode can be solved, and are for its shortest path. With `inscribed` a method plans
    on a map inflated so, since there may be no way on another, unless it chooses the widest inflation
    that leaves a path; with `circumscribed` there is a way on either map, and a method plans on a map of
    its own."""

    def __post_init__(self) -> None:
        """Check the parts' names; nothing is imported."""
        check_robot("EpisodeConditions", self.robot)
        check_tool("EpisodeConditions", self.tool)
        check_engine("EpisodeConditions", self.engine)

    @property
    def env_options(self) -> dict[str, Any]:
        """Time limit, robot, tool, engine and its rate, as arguments of `PushEnv`."""
        return {name: value for name, value in asdict(self).items() if name != "inflation"}

    def agent_options(self, inflation: str | float) -> dict[str, Any]:
        """`env_options` and, where the set asks for a certain map, `inflation` of `make_push_env`.

        Args:
            inflation: The agent's own, `PushEnvConfig.inflation`; `"widest"` finds a path on every set.
        """
        own_map = self.inflation == "circumscribed" or inflation == "widest"
        return self.env_options if own_map else {**self.env_options, "inflation": self.inflation}

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
        """Plain data for files, without SAPIEN and the UR5: older files know no others."""
        only = {("engine", "sapien"), ("robot", "ur5")}
        return {k: v for k, v in asdict(self).items() if (k, v) not in only}

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> "EpisodeConditions":
        """Inverse of `to_dict`.

        Raises:
            ValueError: If a field is missing, unknown or wrong; the message names it.
        """
        return from_plain(cls, data)
