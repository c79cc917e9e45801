"""`SourceEnv`: perception in the place of a simulation, as an environment under an agent's transforms."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from tensordict import TensorDict, TensorDictBase
from torch import Tensor
from torchrl.envs import EnvBase

from modpush.deploy.perception import Perceived
from modpush.envs.engines.base import CONTACT_KEYS
from modpush.envs.outcome import episode_status, is_at_goal, pose_errors
from modpush.envs.robot.robot import Robot, Tool
from modpush.envs.scene_batch import object_entries
from modpush.envs.scenes.arm_room import tool_half_extents
from modpush.envs.scenes.objects import PushedObject
from modpush.envs.scenes.scenario import ScenarioConfig
from modpush.envs.simulation_config import SimulationConfig
from modpush.envs.specs import make_specs
from modpush.geometry.camera import CAMERA, Label
from modpush.geometry.workspace import Rectangle


class SourceEnv(EnvBase):
    """One scene with the keys of `PushEnv`, which emits at each step what `show` was given before.

    The action that it is stepped with is carried out by whoever drives it. Batch size `[1]`.

    Args:
        item: The pushed object.
        robot: The arm.
        tool: Its tool.
        tip_height: Height of the tool's tip over the table [m].
        scenario: Settings of the workspace, of which `low`, `high` and `path_margin` are read.
        simulation: Kind of the goal, ends of episodes and optional entries.
    """

    batch_locked = True

    def __init__(
        self,
        item: PushedObject,
        robot: Robot,
        tool: Tool,
        tip_height: float,
        scenario: ScenarioConfig,
        simulation: SimulationConfig,
    ) -> None:
        # The object may lie at its goal from the beginning.
        super().__init__(
            device=torch.device("cpu"), batch_size=torch.Size([1]), allow_done_after_reset=True
        )
        self.robot, self.scenario = robot, scenario
        self._tool, self._tip_height = tool, tip_height
        self._simulation = replace(simulation, depth="analytic")
        specs = make_specs(1, self.device, len(robot.joints), self._simulation)
        for name, spec in specs.items():
            setattr(self, name, spec)
        about = object_entries(item, simulation.full_circle)
        self._constant = {key: value[None] for key, value in about.items()}
        self.entries: Mapping[str, Tensor] = {}
        """Next emitted entries, by the keys of `PushEnv`."""

    @property
    def bounds(self) -> Rectangle:
        """Lower and upper corner of where the object may be without being out of bounds [m]."""
        return self.scenario.bounds()

    def show(
        self,
        seen: Perceived,
        joints: NDArray[np.float64],
        goal: Sequence[float],
        contact: bool,
        tolerances: tuple[float, float],
    ) -> bool:
        """Set the entries that are emitted next.

        `joints` are the arm's angles [rad], `goal` is x, y and, for goal poses, yaw, and `tolerances` are
        the distance [m] and angle [rad] from it at which the object is there.

        Returns:
            True if the object is at its goal, which counts as a success if the image confirms its pose.
        """
        config, pose, target = self._simulation, np.array([seen.object.pose]), np.array([goal])
        at_goal = is_at_goal(pose[:, :2], target[:, :2], tolerances[0])
        above = CAMERA.z - seen.depth[seen.segmentation == Label.OBSTACLE]
        half_extents = tool_half_extents(self._tool, self._tip_height, above.max(initial=0.0))
        numbers = {
            **self._constant,
            "tool_half_extents": half_extents[None],
            "object_pose": pose,
            "goal_position": target[:, :2],
            "ee_pose": np.array([seen.tip_pose]),
            "joint_position": np.asarray(joints)[None],
        }
        if config.goal == "pose":
            error = pose_errors(pose, target, self._constant["object_symmetry"][:, 0])
            at_goal = at_goal & (np.abs(error[:, 1]) <= tolerances[1])
            numbers |= {"goal_pose": target, "pose_error": error}
        if config.obstacle_motion:
            numbers["obstacle_motion"] = np.zeros((1, 4))  # as `PushEnv` has it where nothing moves
        steps = np.zeros(1, dtype=np.int64)
        success = at_goal & seen.object.found
        status = episode_status(success, pose[:, :2], self.bounds, steps, None, config.oob)
        flags = dict.fromkeys(CONTACT_KEYS, False) | {"target_reachable": True}
        flags |= {"object_contact": contact, "object_contact_at_end": contact}
        flags |= {key: bool(value[0]) for key, value in status._asdict().items()}
        images: dict[str, NDArray[Any]] = {"depth": seen.depth, "segmentation": seen.segmentation}
        self.entries = {
            **{key: torch.tensor([[value]]) for key, value in flags.items()},
            **{key: torch.from_numpy(v.astype(np.float32)) for key, v in numbers.items()},
            **{key: torch.from_numpy(image.copy())[None, None] for key, image in images.items()},
        }
        return bool(at_goal[0])

    def _reset(self, tensordict: TensorDictBase | None = None, **_: Any) -> TensorDictBase:
        return self._emit({})

    def _step(self, tensordict: TensorDictBase) -> TensorDictBase:
        return self._emit({"reward": self.entries["success"].float()})

    def _emit(self, more: Mapping[str, Tensor]) -> TensorDictBase:
        return TensorDict({**self.entries, **more}, batch_size=self.batch_size)

    def _set_seed(self, seed: int | None) -> None:
        """Nothing is drawn here."""
