"""The ManiSkill agents `ur5_2f85` and `ur5_rod`, and the planar controller that drives them."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import torch
from gymnasium import spaces
from mani_skill.agents.base_agent import BaseAgent
from mani_skill.agents.controllers.base_controller import BaseController, ControllerConfig
from mani_skill.agents.controllers.pd_joint_pos import PDJointPosControllerConfig
from mani_skill.agents.registration import register_agent
from torch import Tensor

from modpush.envs.engines.sapien import bodies
from modpush.envs.robot.control import MotionConfig, plan_motion, ramp
from modpush.envs.robot.kinematics import planar_inverse_kinematics
from modpush.envs.robot.physics import DAMPING, STIFFNESS
from modpush.envs.robot.ur5_2f85 import (
    FORCE_LIMIT,
    JOINT_NAMES,
    LINKS,
    TOOLS,
    Tool,
    ToolName,
    urdf_path,
)

__all__ = ["UR5", "PlanarController", "PlanarControllerConfig", "UR5Rod"]


class PlanarController(BaseController):
    """Moves the tip in the plane, tool down, at a constant height: `(dx, dy, dyaw)` in [-1, 1]^3.

    `modpush.envs.robot.control.plan_motion` computes the joint targets; this class interpolates them
    over the substeps and keeps the commanded pose, `target` `[B, 3]` [m, m, rad].
    """

    config: "PlanarControllerConfig"
    sets_target_qpos = True
    sets_target_qvel = True

    def _initialize_action_space(self) -> None:
        self.single_action_space = spaces.Box(-1.0, 1.0, (3,), dtype=np.float32)

    def set_drive_property(self) -> None:
        """Set gains, and the force limits, which SAPIEN's URDF loader drops."""
        for joint, limit in zip(self.joints, FORCE_LIMIT, strict=True):
            joint.set_drive_properties(STIFFNESS, DAMPING, force_limit=limit, mode="force")

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
        pose, _ = self._measure()
        motion = plan_motion(action, self.target, pose, self.flange_height, self.config.motion)
        self.target, self.reachable = motion.target, motion.reachable
        self._ramp = ramp(motion.joints.float(), self._sim_steps, self.control_freq)
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
    """Configuration of the controller for ManiSkill: tool length [m], and limits of the motion."""

    tool_length: float = 0.163
    motion: MotionConfig = field(default_factory=MotionConfig)
    controller_cls = PlanarController


@register_agent()
class UR5(BaseAgent):
    """UR5 with a closed Robotiq 2F-85.

    Control modes: `planar` (ours), and ManiSkill's `pd_joint_pos` and `pd_joint_delta_pos`.
    """

    uid = "ur5_2f85"
    tool_name: ToolName = "2f85"
    urdf_path = str(urdf_path("2f85"))
    disable_self_collisions = True
    motion = MotionConfig()

    @property
    def tool(self) -> Tool:
        """The tool on the flange."""
        return TOOLS[self.tool_name]

    def place_tip(
        self, tip_pose: Sequence[tuple[float, float, float]], tip_height: Sequence[float]
    ) -> None:
        """Put the arms of the scenes that are being reset to where their tips have these poses.

        Args:
            tip_pose: x, y, yaw for each of the scenes [m, m, rad].
            tip_height: Height over the table for each of them [m].

        Raises:
            ValueError: If a pose is out of the arm's reach.
        """
        height = [z + self.tool.length for z in tip_height]
        joints, reachable = planar_inverse_kinematics(
            torch.tensor(tip_pose, dtype=torch.float64), torch.tensor(height, dtype=torch.float64)
        )
        if not reachable.all():
            bad = tip_pose[int(torch.argmin(reachable.int()))]
            raise ValueError(f"Scenario: tool_pose must not be out of the arm's reach, got {bad}.")
        self.reset(joints.float().to(self.device))

    @property
    def _controller_configs(self) -> dict[str, Any]:
        names = list(JOINT_NAMES)
        joint: dict[str, Any] = {
            "stiffness": STIFFNESS,
            "damping": DAMPING,
            "force_limit": FORCE_LIMIT,
        }
        return {
            "planar": PlanarControllerConfig(names, self.tool.length, self.motion),
            "pd_joint_pos": PDJointPosControllerConfig(
                names, None, None, normalize_action=False, **joint
            ),
            "pd_joint_delta_pos": PDJointPosControllerConfig(
                names, -0.05, 0.05, use_delta=True, use_target=True, **joint
            ),
        }

    def _after_loading_articulation(self) -> None:
        shapes = {link.name: link.shapes for link in LINKS} | {"tool": self.tool.shapes}
        for name, parts in shapes.items():
            for raw in self.robot.links_map[name]._objs:
                if self.scene.can_render():
                    bodies.attach_visuals(raw.entity, parts)


@register_agent()
class UR5Rod(UR5):
    """UR5 with the 2 x 2 x 16 cm rod that the authors' released code pushes with."""

    uid = "ur5_rod"
    tool_name: ToolName = "rod"
    urdf_path = str(urdf_path("rod"))
