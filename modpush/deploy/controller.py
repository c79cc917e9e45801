"""`PushController`: an agent as an object with memory and recovery, from depth images to commands."""

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.envs import EnvBase, TransformedEnv, set_exploration_type
from torchrl.envs.utils import ExplorationType, step_mdp

from modpush._types import Length, Positive
from modpush._validation import checked_arguments
from modpush.deploy.perception import Perceived, Sees
from modpush.deploy.place_aside import place_aside
from modpush.deploy.policy_file import load_policy
from modpush.deploy.push_motion import touches
from modpush.deploy.robot_interface import Command, Stopped
from modpush.deploy.source_env import SourceEnv
from modpush.envs.robot.control import MotionConfig, MotionPlanner, PlannedMotion
from modpush.envs.scenes.conditions import SensingConfig
from modpush.mdp.action_frame import ActionFrame
from modpush.mdp.contact_filter import ContactFilter
from modpush.recipes.agent_file import Agent

_TOUCH = 0.004  # distance of tip and object that counts as contact [m]
_MARGINS = 0.005, math.radians(2)
"""Distance [m] and angle [rad] by which the object must be nearer to its goal than the agent's
tolerances, so that it has arrived in truth as well."""
_ARRIVED = 0.01  # distance from a place aside at which the tool is there [m]
_SEEN = 0.5  # share of the object's top, for which the tool stays aside no longer


class PushController:
    """A trained agent that pushes one object on a real table, by depth images and joint angles.

    It is the agent's own stack: planner, sub-goals, window, encoder, observation, network and recovery
    run as in simulation, on what perception sees. It remembers what an episode needs to remember; one
    controller drives one arm.

    Args:
        agent: The agent: of `load_agent`, or a name or file for it, or a folder of `modpush export`.
        perception: Estimates of object and obstacles from depth images.
        rate: Control steps per second [Hz]; None for that of the agent's training. A lower rate makes the
            same motions slower.
        tip_height: Height of the tool's tip over the table [m]; None for that of the object,
            `PushedObject.tool_height`.
        motion: How far a control step goes, and the tool's workspace.
        joint_speed: Speed of a joint from which steps are made shorter [rad/s], near the arm's axis. It
            should be below `Limits.joint_speed`, at which the guard stops the arm.
        look_after: Time of contact with the object without an image that confirms it after which the tool
            steps aside [s], so that the camera sees it again; without contact, twice that time. It should
            be below half of `Limits.lost_for`.

    Raises:
        ValueError: If the agent observes what perception does not measure, or cannot be found.
    """

    @checked_arguments
    def __init__(
        self,
        agent: Agent | str | Path,
        perception: Sees,
        *,
        rate: Positive | None = None,
        tip_height: Length | None = None,
        motion: MotionConfig | None = None,
        joint_speed: Positive = 3.0,
        look_after: Positive = 0.5,
    ) -> None:
        self.agent = agent if isinstance(agent, Agent) else load_policy(agent)
        self.perception = perception
        config = self.agent.config
        if config.simulation.dynamic_obstacles or config.simulation.object_dynamics:
            raise ValueError(
                "PushController: the agent must not observe where movable obstacles are, nor mass, "
                "friction and centre of mass of the object, which perception does not measure."
            )
        self.rate = float(config.simulation.control_freq if rate is None else rate)
        item = perception.item
        self.tip_height = item.tool_height if tip_height is None else tip_height
        self.motion = motion or MotionConfig()
        self._joint_speed, self._patience = joint_speed, look_after
        self._tolerances = (
            max(0.0, config.simulation.position_tolerance - _MARGINS[0]),
            max(0.0, config.simulation.yaw_tolerance - _MARGINS[1]),
        )
        self._source = SourceEnv(
            item,
            perception.robot,
            perception.tool,
            self.tip_height,
            config.scenario,
            config.simulation,
        )
        self._env = self.agent.make_env(1, base=self._source, sensing=SensingConfig())
        self._policy = self.agent.policy
        self._planner = MotionPlanner(perception.robot, self.motion, 1, self.rate)
        self.goal: tuple[float, ...] | None = None
        """Goal of the object: x, y, and yaw for a goal pose [m, m, rad]."""
        self.perceived: Perceived | None = None
        """Estimates and images from the last depth image."""
        self.success = False
        """True if the object is at the goal, by an image that confirms its pose."""
        self.contact = False
        """True if the tip touches the object, by the last image."""
        self._state: TensorDictBase | None = None
        self._target = np.zeros(3)
        self._aside: NDArray[np.float64] | None = None

    @property
    def path_found(self) -> bool:
        """True if the planner has found a way for the object to its goal."""
        assert self._state is not None
        found = self._state.get("path_found", None)
        return True if found is None else bool(found)

    def reset(self, goal: Sequence[float], guess: Sequence[float] | None = None) -> None:
        """Begin an episode with the next image.

        Args:
            goal: x, y of the object's goal [m], and its yaw [rad] for an agent of goal poses.
            guess: Place (x, y) or pose (x, y, yaw) near which the object is [m, m, rad]; None looks
                everywhere.

        Raises:
            ValueError: If goal or guess have another length, or are not finite.
        """
        self.goal = self._checked_goal(goal)
        self.perception.reset(guess)
        self._state, self.perceived, self._aside = None, None, None
        self.success = self.contact = False
        self._pushed_unseen, self._arrived_unseen = 0, False

    def _checked_goal(self, goal: Sequence[float]) -> tuple[float, ...]:
        size = 3 if self.agent.config.simulation.goal == "pose" else 2
        values = tuple(float(v) for v in goal)
        if len(values) != size or not all(map(math.isfinite, values)):
            raise ValueError(f"PushController: goal must be {size} finite numbers, got {goal!r}.")
        return values

    def look(self, depth: NDArray[np.float32], joints: NDArray[np.float64]) -> None:
        """Take in an image before the first command, while the arm stands aside and hides nothing.

        Args:
            depth: See `act`.
            joints: See `act`.

        Raises:
            Stopped: If it does not show the object.
            ValueError: If image or joints have another shape.
        """
        self._see(depth, joints)

    def _see(self, depth: NDArray[np.float32], joints: NDArray[np.float64]) -> Perceived:
        first = self.perceived is None
        seen = self.perception.update(depth, joints)
        if seen is None or (first and not seen.object.found):
            raise Stopped(
                "object_not_found",
                f"the first image does not show the object {self.perception.item.name!r}; put it on the "
                "table where camera and arm do not hide it, with no obstacle touching it.",
            )
        self.perceived = seen
        return seen

    def act(
        self,
        depth: NDArray[np.float32],
        joints: NDArray[np.float64],
        goal: Sequence[float] | None = None,
    ) -> Command:
        """The command for the next control step.

        Args:
            depth: `[H, W]` image of the calibrated camera, along its optical axis [m]; 0 or NaN without a
                reading.
            joints: Angles of the arm's joints when it was taken, `[n]` [rad].
            goal: Goal of the object if it has changed since `reset`.

        Raises:
            Stopped: If the first image of an episode does not show the object.
            RuntimeError: If `reset` was not called.
            ValueError: If image, joints or goal have another shape.
        """
        if self.goal is None:
            raise RuntimeError("PushController.act: call reset first.")
        if goal is not None:
            self.goal = self._checked_goal(goal)
        first, seen = self._state is None, self._see(depth, joints)
        self._show(seen, joints, self.goal)
        state = self._decide()
        tip = np.array([seen.tip_pose])
        if first:
            self._target = tip
        action = np.clip(self._base_action(state).double().numpy(), -1.0, 1.0)
        if self._steps_aside(seen, joints):
            action[0] = *(self._aside - tip[0, :2]) / self.motion.max_step, 0.0
            action /= max(1.0, np.abs(action).max())
        planned = self._plan(action, tip, joints)
        self._target = planned.target
        return Command(
            start=planned.start[0],
            target=planned.target[0].copy(),
            height=self.tip_height,
            joints=planned.position[0, -1],
            duration=1 / self.rate,
            reachable=bool(planned.reachable[0]),
        )

    def _show(self, seen: Perceived, joints: NDArray[np.float64], goal: tuple[float, ...]) -> None:
        """Set the entries that the agent reads, contact and success."""
        sees, found = self.perception, seen.object.found
        flange = sees.robot.link_transforms(joints)[-1]
        self.contact = touches(sees.tool, flange, sees.item, seen.object.pose, _TOUCH)
        arrived = self._source.show(seen, joints, goal, self.contact, self._tolerances)
        self.success, self._arrived_unseen = arrived and found, arrived and not found

    def _steps_aside(self, seen: Perceived, joints: NDArray[np.float64]) -> bool:
        """True while the tool makes way for the camera, to the place `_aside`."""
        estimate = seen.object
        self._pushed_unseen = 0 if estimate.found else self._pushed_unseen + self.contact
        unsure = max(self._pushed_unseen, estimate.unseen_for / 2)
        unsure_enough = unsure >= self._patience * self.rate or self._arrived_unseen
        if self._aside is None and unsure_enough:
            self._aside = place_aside(self.perception, seen, joints, self.tip_height, self.motion)
        if self._aside is not None:
            arrived = math.dist(self._aside, seen.tip_pose[:2]) < _ARRIVED
            if arrived or (estimate.found and estimate.hidden < 1 - _SEEN):
                self._aside = None
        return self._aside is not None

    def _plan(
        self, action: NDArray[np.float64], tip: NDArray[np.float64], joints: NDArray[np.float64]
    ) -> PlannedMotion:
        """The motion of a control step, shortened where a joint would be too fast."""
        height = np.array([self.tip_height + self.perception.tool.length])
        for _ in range(3):
            planned = self._planner.plan(action, self._target, tip, height, joints[None])
            speed = float(np.abs(planned.position[0, -1] - joints).max()) * self.rate
            if speed <= self._joint_speed:
                break
            action = action * (0.9 * self._joint_speed / speed)
        return planned

    def _decide(self) -> TensorDictBase:
        """Run transforms and policy on the present entries."""
        with torch.no_grad(), set_exploration_type(ExplorationType.DETERMINISTIC):
            if self._state is None:
                state = self._env.reset()
            else:
                state = step_mdp(self._env.step(self._state))
            self._state = self._policy(state)
        return self._state

    def _base_action(self, state: TensorDictBase) -> Tensor:
        """The action (dx, dy, dyaw) in the base frame, `[1, 3]`."""
        action = state["action"]
        for transform in reversed(_transforms(self._env)):  # as an environment is stepped
            if isinstance(transform, ActionFrame):
                action = transform.to_base(state)
            elif isinstance(transform, ContactFilter):
                action = transform.filter(state, action)
        return action


def _transforms(env: EnvBase) -> list[Any]:
    return list(env.transform) if isinstance(env, TransformedEnv) else []
