"""From a planar action to joint targets, for a batch of arms and without a simulator.

The loops over scenes, knots and substeps are compiled: a hundred operations on a few numbers would each
cost 5 microseconds in torch.
"""

import math
from collections.abc import Sequence
from typing import Annotated, Any, NamedTuple

import numpy as np
from annotated_types import Le
from numpy.typing import NDArray

from modpush._kernels import njit
from modpush._types import Count, Length, Point, Positive
from modpush._validation import checked
from modpush.envs.robot.robot import Robot, Tool

_LED = 30  # solutions on the way to an episode's start
_LAST = 0.3  # weight of the last joint, which follows yaw, in the distance from home
_OTHER_TURNS = (0.0, -1.0, 1.0)  # where the action has no solution
_LARGEST_STEP = 0.5  # of a joint from one knot to the next [rad]; a UR5's are below 0.1


@checked
class MotionConfig:
    """Motion of the tool by an action in [-1, 1]^3, and the limits of its position."""

    max_step: Length = 0.02
    """Largest translation per axis and control step [m]."""
    max_turn: Positive = 0.05
    """Largest rotation per control step [rad]."""
    anchor_distance: Length = 0.012
    """Largest distance from the measured tip to the target at the start of a step [m], so that a
    blocked arm does not wind up."""
    anchor_angle: Positive = 0.1
    """Largest yaw angle from the measured tip to the target at the start of a step [rad]."""
    low: Point = (0.08, -0.47)
    """Lower corner (x, y) of the tool's workspace, 12 cm outside the objects' workspace [m]."""
    high: Point = (0.87, 0.47)
    """Upper corner (x, y) of the tool's workspace [m]."""
    num_knots: Annotated[Count, Le(1000)] = 4
    """Number of inverse kinematics solutions per control step; joint targets are interpolated between
    them. With one jump per step the tip would knock the object ahead instead of pushing it."""

    def __post_init__(self) -> None:
        if not (self.low[0] < self.high[0] and self.low[1] < self.high[1]):
            raise ValueError(f"MotionConfig: low must be < high, got {self.low} and {self.high}.")


class OutOfReachError(ValueError):
    """The arm cannot reach the pose of its tool."""


class PlannedMotion(NamedTuple):
    """Commands of one control step."""

    target: NDArray[np.float64]
    """Planar pose of the tip at the end of the step, yaw not wrapped, `[B, 3]` [m, m, rad]."""
    position: NDArray[np.float64]
    """Joint targets at the end of each physics step, `[B, S, n]` [rad]."""
    velocity: NDArray[np.float64]
    """Velocity targets in it, `[B, S, n]` [rad/s]. Without them the drives' damping makes the tip lag by
    7 mm at full speed, with them by 1 mm."""
    reachable: NDArray[np.bool_]
    """False where the commanded pose has no solution: the tip then moves without the turn, or it turns in
    one of both directions as far as a step allows, or else the target stays, `[B]`."""
    start: NDArray[np.float64]
    """Planar pose at which the step starts, near the measured one, `[B, 3]` [m, m, rad]."""


class _Limits(NamedTuple):
    """The numbers that the compiled functions read; see `MotionConfig` and `Robot`."""

    max_step: float
    max_turn: float
    anchor_distance: float
    anchor_angle: float
    low_x: float
    low_y: float
    high_x: float
    high_y: float
    min_radius: float
    max_radius: float
    base_x: float
    base_y: float


class MotionPlanner:
    """Turns actions into ramps of joint targets, for `num_substeps` physics steps per control step."""

    def __init__(
        self, robot: Robot, config: MotionConfig, num_substeps: int, control_freq: float
    ) -> None:
        self._limits = _Limits(
            config.max_step,
            config.max_turn,
            config.anchor_distance,
            config.anchor_angle,
            *config.low,
            *config.high,
            *robot.reach,
            *robot.base[:2],
        )
        self._base = np.array(robot.base)
        self._inverse, self._num_knots = robot.inverse, config.num_knots
        self._ramp = num_substeps, control_freq

    def plan(
        self,
        action: NDArray[np.float64],
        target: NDArray[np.float64],
        tip_pose: NDArray[np.float64],
        flange_height: NDArray[np.float64],
        joints: NDArray[np.float64],
    ) -> PlannedMotion:
        """Plan one control step of a batch of arms.

        Args:
            action: `[B, 3]` in [-1, 1]; values beyond are clipped.
            target: The previous step's target, `[B, 3]` [m, m, rad].
            tip_pose: The measured pose of the tip, `[B, 3]` [m, m, rad].
            flange_height: Height of the flange over the table, `[B]` [m].
            joints: The measured angles of the joints, `[B, n]` [rad].
        """
        given = target, tip_pose, flange_height, joints
        motion = self._attempt(action, *given)
        stuck = np.flatnonzero(~motion.reachable)
        for turn in _OTHER_TURNS:  # at the limit of its last joint an arm may still push
            if not len(stuck):
                break
            action = np.array(action)
            action[:, 2] = turn
            other = self._attempt(action[stuck], *(values[stuck] for values in given))
            for mine, found in zip(motion[:3], other[:3], strict=True):
                mine[stuck[other.reachable]] = found[other.reachable]
            stuck = stuck[~other.reachable]
        return motion

    def _attempt(
        self,
        action: NDArray[np.float64],
        target: NDArray[np.float64],
        tip_pose: NDArray[np.float64],
        flange_height: NDArray[np.float64],
        joints: NDArray[np.float64],
    ) -> PlannedMotion:
        """The motion of an action itself, or a halt."""
        start, goal = _aim(action, target, tip_pose, self._limits)
        return self.ramp(start, goal, flange_height, joints)

    def ramp(
        self,
        start: NDArray[np.float64],
        goal: NDArray[np.float64],
        flange_height: NDArray[np.float64],
        joints: NDArray[np.float64],
    ) -> PlannedMotion:
        """Joint targets on the straight way from start to goal, `[B, 3]` each; the rest is as in `plan`.

        Where the way is out of reach, `goal` is overwritten by the start.
        """
        rows = self._num_knots + 1
        moved = (goal - start)[:, None] * np.arange(rows)[:, None] / self._num_knots
        way = np.empty((len(start), rows, 4))
        way[..., [0, 1, 3]] = start[:, None] + moved
        way[..., 2] = flange_height[:, None]
        way[..., :3] -= self._base
        knots, found = self._inverse(way.reshape(-1, 4), joints.repeat(rows, axis=0))
        target, position, velocity, reachable = _ramp(
            start, goal, joints, knots, found, rows, *self._ramp
        )
        return PlannedMotion(target, position, velocity, reachable, start)


def start_joints(
    robot: Robot, tool: Tool, tool_pose: Sequence[float], tip_height: float
) -> NDArray[np.float32]:
    """Angles of the joints that hold the tool's tip at a pose (x, y, yaw) [m, m, rad], `[n]` [rad].

    Of several solutions it is that nearest to home. An arm whose last joint cannot turn all around may
    hold a tool turned by half a turn, if that makes no difference (`Tool.half_turn`). The tip's height is
    over the table [m].

    Raises:
        OutOfReachError: If the arm cannot reach the pose.
        ValueError: If its inverse kinematics returns something else than an `InverseKinematics`.
    """
    (x, y, yaw), n, home = tool_pose, len(robot.joints), np.array(robot.home)
    place = np.array([x, y, tip_height + tool.length]) - robot.base
    low, high = robot.joints[-1].limits
    # A yaw beyond the last joint's limit is that of a turn in the other direction.
    turns = np.array([0.0, -2 * math.pi, 2 * math.pi])
    if tool.half_turn and high - low < 2 * math.pi:
        turns = np.concatenate([turns, turns + math.pi])
    if robot.solve is None:
        joints, found = _led_from_home(robot, place, yaw + turns)
    else:
        joints, found = checked_solution(
            robot, np.column_stack([np.tile(place, (len(turns), 1)), yaw + turns])
        )
    if not found.any():
        raise OutOfReachError(
            f"Scenario: tool_pose must not be out of the arm's reach, got {tuple(tool_pose)} with robot "
            f"{robot.name!r}, whose inverse kinematics finds nothing there. modpush.envs.within_reach "
            "leaves such episodes out."
        )
    weight = np.array([*[1.0] * (n - 1), _LAST])
    away = np.where(found, np.linalg.norm((joints - home) * weight, axis=1), np.inf)
    return joints[int(np.argmin(away))].astype(np.float32)


def checked_solution(
    robot: Robot, poses: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Joint angles by the robot's own `solve` from home, checked."""
    n, count = len(robot.joints), len(poses)
    solved: Any = robot.inverse(poses, np.tile(robot.home, (count, 1)))
    shapes = [np.shape(part) for part in solved]
    if shapes != [(count, n), (count,)] or not np.isfinite(solved[0]).all():
        raise ValueError(
            f"Robot {robot.name!r}: solve must return finite joints [N, {n}] and found [N], got shapes "
            f"{shapes} for N = {count}."
        )
    joints, found = solved
    return joints, found


def _led_from_home(
    robot: Robot, place: NDArray[np.float64], yaws: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Joint angles of the numerical solution that is continued from home, around the base.

    So the arm bends as at home wherever it can, and one with more joints than it needs is drawn there.
    """
    flange = robot.link_transforms(np.array(robot.home))[-1]
    (x, y, z), home_yaw = flange[:3, 3] - robot.base, math.atan2(flange[1, 0], flange[0, 0])
    turn = (math.atan2(place[1], place[0]) - math.atan2(y, x) + math.pi) % (2 * math.pi) - math.pi
    yaws = yaws + 2 * math.pi * round((home_yaw - yaws[0]) / (2 * math.pi))
    joints, found = np.tile(robot.home, (len(yaws), 1)), np.ones(len(yaws), np.bool_)
    for part in np.linspace(0.0, 1.0, _LED):
        radius = math.hypot(x, y) + part * (math.hypot(place[0], place[1]) - math.hypot(x, y))
        azimuth, poses = math.atan2(y, x) + part * turn, np.empty((len(yaws), 4))
        poses[:, 0], poses[:, 1] = radius * math.cos(azimuth), radius * math.sin(azimuth)
        poses[:, 2], poses[:, 3] = z + part * (place[2] - z), home_yaw + part * (yaws - home_yaw)
        left = np.flatnonzero(found)
        joints[left], found[left] = robot.inverse(poses[left], joints[left])
    if not found.any():  # a joint is at its limit on the way
        return checked_solution(robot, np.column_stack([np.tile(place, (len(yaws), 1)), yaws]))
    return joints, found


@njit()
def _aim(
    action: NDArray[np.float64],
    target: NDArray[np.float64],
    tip_pose: NDArray[np.float64],
    limits: _Limits,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Start of a step, near the tip, and its end, in the workspace: its box, then the ring, `[B, 3]`."""
    starts, goals = np.empty((len(action), 3)), np.empty((len(action), 3))
    for b in range(len(action)):
        start, goal, tip = starts[b], goals[b], tip_pose[b]
        dx, dy = target[b, 0] - tip[0], target[b, 1] - tip[1]
        pull = min(limits.anchor_distance / max(math.hypot(dx, dy), 1e-12), 1.0)
        turn = (target[b, 2] - tip[2] + math.pi) % (2 * math.pi) - math.pi
        start[0], start[1] = tip[0] + dx * pull, tip[1] + dy * pull
        kept = min(max(turn, -limits.anchor_angle), limits.anchor_angle)
        start[2] = target[b, 2] - (turn - kept)
        for i in range(2):
            goal[i] = start[i] + min(max(action[b, i], -1.0), 1.0) * limits.max_step
        goal[0] = min(max(goal[0], limits.low_x), limits.high_x)
        goal[1] = min(max(goal[1], limits.low_y), limits.high_y)
        goal[2] = start[2] + min(max(action[b, 2], -1.0), 1.0) * limits.max_turn
        dx, dy = goal[0] - limits.base_x, goal[1] - limits.base_y
        radius = max(math.hypot(dx, dy), 1e-12)
        scale = min(max(radius, limits.min_radius), limits.max_radius) / radius
        goal[0] = limits.base_x + dx * scale
        goal[1] = limits.base_y + dy * scale
    return starts, goals


@njit()
def _ramp(
    start: NDArray[np.float64],
    goal: NDArray[np.float64],
    joints: NDArray[np.float64],
    knots: NDArray[np.float64],
    found: NDArray[np.bool_],
    rows: int,
    num_substeps: int,
    control_freq: float,
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64], NDArray[np.bool_]]:
    """The fields of `PlannedMotion`: straight ramps from knot to knot, or a halt at the first one.

    Each scene has `rows` of the knots, `[B * rows, n]`.
    """
    B, num_knots, n = len(goal), rows - 1, knots.shape[1]
    position, velocity = np.empty((B, num_substeps, n)), np.empty((B, num_substeps, n))
    reachable = np.ones(B, np.bool_)
    for b in range(B):
        first = b * rows
        reachable[b] = found[first : first + rows].all()
        for k in range(rows):  # from another branch the tip would come swinging
            for j in range(n):
                before = joints[b, j] if k == 0 else knots[first + k - 1, j]
                reachable[b] &= abs(knots[first + k, j] - before) < _LARGEST_STEP
        if not reachable[b]:
            goal[b] = start[b]
        for s in range(num_substeps):
            at = (s + 1) * num_knots / num_substeps
            left = int(math.ceil(at - 1e-9)) - 1
            here, there = (first + left, first + left + 1) if reachable[b] else (first, first)
            for j in range(n):
                step = knots[there, j] - knots[here, j]
                position[b, s, j] = knots[here, j] + (at - left) * step
                velocity[b, s, j] = step * (num_knots * control_freq)
    return goal, position, velocity, reachable
