"""`SourceEnv`: entries that come from outside, as an environment under an agent's transforms."""

from collections.abc import Mapping
from typing import Any

import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor
from torchrl.envs import EnvBase

from modpush.envs.outcome import Goal
from modpush.envs.robot.robot import Robot
from modpush.envs.scenes.scenario import ScenarioConfig
from modpush.envs.specs import make_specs
from modpush.geometry.workspace import Rectangle


class SourceEnv(EnvBase):
    """One scene with the keys of `PushEnv`, which emits at each step what it was given before.

    The action that it is stepped with is carried out by whoever drives it. Batch size `[1]`.

    Args:
        robot: The arm.
        scenario: Settings of the workspace, of which `low`, `high` and `path_margin` are read.
        goal: What an episode asks for.
        obstacle_motion: Emit `obstacle_motion`.
    """

    batch_locked = True

    def __init__(
        self,
        robot: Robot,
        scenario: ScenarioConfig,
        goal: Goal = "position",
        obstacle_motion: bool = False,
    ) -> None:
        # The object may lie at its goal from the beginning.
        super().__init__(
            device=torch.device("cpu"), batch_size=torch.Size([1]), allow_done_after_reset=True
        )
        self.robot, self.scenario = robot, scenario
        specs = make_specs(
            1,
            self.device,
            len(robot.joints),
            images=True,
            dynamic_obstacles=False,
            goal=goal,
            obstacle_motion=obstacle_motion,
        )
        for name, spec in specs.items():
            setattr(self, name, spec)
        self.entries: Mapping[str, Tensor] = {}
        """Next emitted entries, by the keys of `PushEnv`."""

    @property
    def bounds(self) -> Rectangle:
        """Lower and upper corner of where the object may be without being out of bounds [m]."""
        return self.scenario.bounds()

    def _reset(self, tensordict: TensorDictBase | None = None, **_: Any) -> TensorDictBase:
        return self._emit({})

    def _step(self, tensordict: TensorDictBase) -> TensorDictBase:
        return self._emit({"reward": self.entries["success"].float()})

    def _emit(self, more: Mapping[str, Tensor]) -> TensorDictBase:
        return TensorDict({**self.entries, **more}, batch_size=self.batch_size)

    def _set_seed(self, seed: int | None) -> None:
        """Nothing is drawn here."""
