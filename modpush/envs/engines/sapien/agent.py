"""The ManiSkill agents of an arm with a tool, and the planar controller that drives them."""

import atexit
import functools
import hashlib
import shutil
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import mkdtemp
from typing import Any, ClassVar

import numpy as np
import torch
from gymnasium import spaces
from mani_skill.agents.base_agent import BaseAgent
from mani_skill.agents.controllers.base_controller import BaseController, ControllerConfig
from mani_skill.agents.controllers.pd_joint_pos import PDJointPosControllerConfig
from torch import Tensor

from modpush.envs.engines.sapien import bodies
from modpush.envs.robot.control import MotionConfig, MotionPlanner, start_joints
from modpush.envs.robot.robot import Robot, Tool
from modpush.envs.robot.urdf import urdf_text


class PlanarController(BaseController):
    """Moves the tip in the plane, tool down, at a constant height: `(dx, dy, dyaw)` in [-1, 1]^3.

    `MotionPlanner` computes the joint targets, on the CPU; this class sets them in each substep and keeps
    the commanded pose, `target` `[B, 3]` [m, m, rad].
    """

    config: "PlanarControllerConfig"
    sets_target_qpos = True
    sets_target_qvel = True

    def _initialize_action_space(self) -> None:
        self.single_action_space = spaces.Box(-1.0, 1.0, (3,), dtype=np.float32)

    def set_drive_property(self) -> None:
        """Set gains, and the force limits, which SAPIEN's URDF loader drops."""
        arm = self.config.arm
        for joint, of in zip(self.joints, arm.joints, strict=True):
            joint.set_drive_properties(
                arm.stiffness, arm.damping, force_limit=of.effort, mode="force"
            )

    def reset(self) -> None:
        """Make the measured pose the target in the scenes that are being reset."""
        mask = self.scene._reset_mask
        pose, height = self._measure()
        if not hasattr(self, "target"):
            self.target, self.flange_height = pose, height
            self.reachable = torch.ones(len(pose), dtype=torch.bool, device=self.device)
        self.target = torch.where(mask[:, None], pose, self.target)
        self.flange_height = torch.where(mask, height, self.flange_height)
        self._ramp: tuple[Tensor, Tensor] | None = None

    def _measure(self) -> tuple[Tensor, Tensor]:
        """Planar pose of the tip `[B, 3]` and height of the flange `[B]`."""
        pose = self.articulation.links_map["tip"].pose
        yaw = tip_yaw(pose.q.double())
        position = pose.p.double()
        height = position[:, 2] + self.config.tool_length
        return torch.cat([position[:, :2], yaw[:, None]], -1), height

    def set_action(self, action: Tensor) -> None:
        """Plan the joint targets of one control step.

        Args:
            action: `[B, 3]` in [-1, 1].
        """
        action = self._preprocess_action(torch.as_tensor(action, device=self.device))
        given = action, self.target, self._measure()[0], self.flange_height, self.qpos
        planner = MotionPlanner(
            self.config.arm, self.config.motion, self._sim_steps, self.control_freq
        )
        planned = planner.plan(*(values.double().cpu().numpy() for values in given))
        target, position, velocity, reachable = (
            torch.from_numpy(values).to(self.device) for values in planned[:4]
        )
        self.target, self.reachable = target, reachable
        self._ramp = position.float(), velocity.float()
        self._substep = 0
        self._set_drive_targets()  # ManiSkill sends targets to a GPU once per action, right after this

    def before_simulation_step(self) -> None:
        """Set the drives' targets for the next substep."""
        if self._ramp is not None and self._substep < self._sim_steps:
            self._set_drive_targets()
            self._substep += 1

    def _set_drive_targets(self) -> None:
        assert self._ramp is not None
        position, velocity = (values[:, self._substep] for values in self._ramp)
        self.articulation.set_joint_drive_targets(position, self.joints, self.active_joint_indices)
        self.articulation.set_joint_drive_velocity_targets(
            velocity, self.joints, self.active_joint_indices
        )
        if self.scene.gpu_sim_enabled:
            self.scene.px.gpu_apply_articulation_target_position()
            self.scene.px.gpu_apply_articulation_target_velocity()

    def get_state(self) -> dict[str, Tensor]:
        """The commanded pose and height."""
        return {"target": self.target.clone(), "flange_height": self.flange_height[:, None].clone()}

    def set_state(self, state: Mapping[str, Any]) -> None:
        """Inverse of `get_state`; ManiSkill's replay gives arrays, without the dimension of scenes."""
        target, height = (torch.as_tensor(state[key]) for key in ("target", "flange_height"))
        self.target = target.reshape(-1, 3).to(self.target, copy=True)
        self.flange_height = height.reshape(-1).to(self.flange_height, copy=True)
        self._ramp = None


def tip_yaw(quaternion: Tensor) -> Tensor:
    """Yaw [rad] of the x axis of a tool that points down; quaternions (w, x, y, z), `[..., 4]`."""
    w, x, y, z = quaternion.unbind(-1)
    return torch.atan2(2 * (x * y + w * z), 1 - 2 * (y * y + z * z))


@dataclass
class PlanarControllerConfig(ControllerConfig):
    """Configuration of the controller for ManiSkill: arm, tool length [m], limits of the motion."""

    arm: Robot
    tool_length: float
    motion: MotionConfig = field(default_factory=MotionConfig)
    controller_cls = PlanarController


class PushArm(BaseAgent):
    """An arm with a tool; `agent_class` makes one of `Robot` and `Tool`.

    Control modes: `planar` (ours), and ManiSkill's `pd_joint_pos` and `pd_joint_delta_pos`.
    """

    arm: ClassVar[Robot]
    tool: ClassVar[Tool]
    disable_self_collisions = True
    motion = MotionConfig()

    def place_tip(
        self, tip_pose: Sequence[tuple[float, float, float]], tip_height: Sequence[float]
    ) -> None:
        """Put the tips of the scenes being reset to poses (x, y, yaw), at heights over the table."""
        joints = [
            start_joints(self.arm, self.tool, pose, height)
            for pose, height in zip(tip_pose, tip_height, strict=True)
        ]
        self.reset(torch.from_numpy(np.array(joints)).to(self.device))

    @property
    def _controller_configs(self) -> dict[str, Any]:
        arm, names = self.arm, [joint.name for joint in self.arm.joints]
        joint: dict[str, Any] = {
            "stiffness": arm.stiffness,
            "damping": arm.damping,
            "force_limit": [joint.effort for joint in arm.joints],
        }
        return {
            "planar": PlanarControllerConfig(names, arm, self.tool.length, self.motion),
            "pd_joint_pos": PDJointPosControllerConfig(
                names, None, None, normalize_action=False, **joint
            ),
            "pd_joint_delta_pos": PDJointPosControllerConfig(
                names, -0.05, 0.05, use_delta=True, use_target=True, **joint
            ),
        }

    def _after_loading_articulation(self) -> None:
        shapes = {link.name: link.shapes for link in self.arm.links} | {"tool": self.tool.shapes}
        for name, parts in shapes.items():
            for raw in self.robot.links_map[name]._objs:
                if self.scene.can_render():
                    bodies.attach_visuals(raw.entity, parts)


def agent_class(arm: Robot, tool: Tool) -> type[PushArm]:
    """The ManiSkill agent of an arm with a tool."""
    uid = f"{arm.name}_{tool.name}"
    fields = {"uid": uid, "arm": arm, "tool": tool, "urdf_path": _urdf_file(arm, tool)}
    return type("PushArm", (PushArm,), fields)


@functools.cache
def _folder() -> Path:
    """A folder that is deleted at the end of the process."""
    folder = mkdtemp(prefix="modpush_urdf_")
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    return Path(folder)


def _urdf_file(arm: Robot, tool: Tool) -> str:
    """SAPIEN reads a URDF from files only."""
    text = urdf_text(arm, tool)
    path = _folder() / f"{hashlib.sha256(text.encode()).hexdigest()[:16]}.urdf"
    if not path.exists():
        path.write_text(text, encoding="utf-8")
    return str(path)
