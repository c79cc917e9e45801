"""`ContactFilter`: the nearest action by which nothing is predicted to run into an obstacle."""

import functools
import math
from typing import Any

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from tensordict import NestedKey, TensorDictBase
from torchrl.data import TensorSpec

from modpush._checks import check_spec_has, read_key
from modpush._transforms import DescribedTransform, add_unbounded
from modpush._types import NonNegative, Positive
from modpush._validation import checked_arguments
from modpush.geometry.camera import Camera, cells_at, unpack_cells
from modpush.geometry.workspace import Rectangle
from modpush.mdp.predicted_contact import nearest_action
from modpush.mdp.push_prediction import PushedScene, directions, outline

_FRICTION = 0.5  # between object and table; the usual value, which is not measured
_GRAVITY = 9.81  # [m/s^2]
_AHEAD = 6.0  # time for which the way of a moving obstacle is looked ahead [s]
_SLACK = 0.5  # time after which the object can still be pushed out of its way [s]
_STAYS = 0.01  # motion of the object up to which it is still in its place [m]
_PATIENCE = 2.0  # time in which the object stays, after which less and less distance is kept [s]
_RELEASE = 2.0  # further time in which those distances fall to none [s]


class ContactFilter(DescribedTransform):
    """Replaces actions after which tool or object are predicted to touch an obstacle, or to leave.

    For every action it predicts how the tool moves and pushes the object, which turns where it is pushed
    beside its centre and slides on against friction, until both stand still (Lynch, Maekawa and Tanie
    1992). If the tool comes nearer to an obstacle than `clearance`, the object nearer than
    `object_clearance` and a fifth of its motion, since so much the prediction may be wrong, or if the
    object's centre is pushed nearer than `edge` to where an episode ends, the nearest of 175 other
    actions takes its place, where violations are added to its distance as a cost. An object that is
    nearer than `edge` already can be pushed along it, and one that is nearer than `object_clearance`
    may stay as near, down to half of that and a fifth of its motion. An action without such a
    prediction is only clipped to [-1, 1].

    A policy that is kept from the only push that it knows would wait for ever. Where the object has
    stayed within 1 cm for 2 s, the tool's way to it included, `object_clearance` and `edge` fall, and
    after 4 s nothing is left but the fifth of the object's motion. The tool's distance stays, and so do
    the distances from obstacles on ways out of a moving obstacle's way.

    An obstacle that moves, the one of `obstacle_motion_key` with what touches it on the map, counts where
    it is and where it will be. It is taken to move straight on at its speed, and to turn round once, at
    the edge of `patrol_area`. If it is predicted to come against the object in the next 6 s, the agent
    acts as long as half a second after its action there still is a way to push the object aside, on
    which the tool may go round it and which takes 3 s at most. Then the filter takes the quickest such
    way. If there is none any more, the agent acts.

    Like `ActionFrame`, it works on the way to the environment, after the action has been turned into
    the base frame: put it before `ActionFrame`. What is stored is the agent's own action. It reads what
    the agent observes, obstacles from the depth image.

    Args:
        tip_half_extents: Half of the sides of the tool's tip along its x and y, with which it pushes [m].
        bounds: Lower and upper corner (x, y) of the area in which the object's centre may be [m].
        patrol_area: Area at whose edge the centre of a moving obstacle is taken to turn round [m]; None
            if it moves straight on.
        max_step: Motion of the tool along each axis by an action of 1 [m].
        max_turn: Turn of the tool by an action of 1 [rad].
        step_time: Duration of a control step [s].
        clearance: Smallest predicted distance of the tool from obstacles, and of the object on ways out
            of a moving obstacle's way [m].
        object_clearance: Smallest predicted distance of the object from obstacles elsewhere [m].
        edge: Smallest predicted distance of a pushed object's centre from the edge of `bounds` [m].
        camera: The camera whose grid the blocked cells are on.
        action_key: Read and replaced on its way, `[..., 3]` (dx, dy, dyaw) in [-1, 1], base frame.
        blocked_key: Read, `[..., H, N]` uint8: blocked cells as bits, as `OccupancyGrid` writes them.
        object_pose_key: Read, `[..., 3]` (x, y, yaw) [m, rad].
        ee_pose_key: Read, `[..., 3]` (x, y, yaw) of the tool's tip [m, rad].
        object_support_key: Read, `[..., n]`: how far the object reaches in n directions of its own [m].
        tool_key: Read where it is there, `[..., 2]`: half of the sides of what the tool has at the height
            of obstacles [m]. Without it that is the tip.
        obstacle_motion_key: Read where it is there, `[..., 4]`: place and velocity (x, y) of an obstacle
            [m, m/s].
        previous_key: Written in each step, and read where it is there, `[..., 3]`: the object's pose
            before the step (x, y, yaw) [m, rad]. Without it the object is taken to stand still.
        stalled_key: Written in each step, and read where it is there, `[..., 3]` float32: the place where
            the object stays (x, y) [m], and the number of steps there. Without it they are counted from
            this step on.

    Raises:
        ValueError: If a number is out of its range.
        KeyError: If a key is missing when an action is filtered.
    """

    @checked_arguments
    def __init__(
        self,
        tip_half_extents: tuple[Positive, Positive],
        bounds: Rectangle,
        *,
        patrol_area: Rectangle | None = None,
        max_step: Positive = 0.02,
        max_turn: Positive = 0.05,
        step_time: Positive = 1 / 15,
        clearance: NonNegative = 0.005,
        object_clearance: NonNegative = 0.01,
        edge: NonNegative = 0.02,
        camera: Camera | None = None,
        action_key: NestedKey = "action",
        blocked_key: NestedKey = "blocked_bits",
        object_pose_key: NestedKey = "object_pose",
        ee_pose_key: NestedKey = "ee_pose",
        object_support_key: NestedKey = "object_support",
        tool_key: NestedKey = "tool_half_extents",
        obstacle_motion_key: NestedKey = "obstacle_motion",
        previous_key: NestedKey = "previous_object_pose",
        stalled_key: NestedKey = "stalled",
    ) -> None:
        super().__init__(
            in_keys=[object_pose_key],
            out_keys=[previous_key, stalled_key],
            in_keys_inv=[action_key],
            out_keys_inv=[action_key],
        )
        self.clearance, self.object_clearance, self.edge = clearance, object_clearance, edge
        self.patrol_area = patrol_area
        self.camera = camera or Camera()
        self._motion = np.array([max_step, max_step, max_turn])
        self._tool, self._step_time = np.array(tip_half_extents), step_time
        self._bounds = np.array([*bounds[0], *bounds[1]])
        self._inward = np.array([edge, edge, -edge, -edge])
        self.action_key, self.blocked_key = action_key, blocked_key
        self.object_pose_key, self.ee_pose_key = object_pose_key, ee_pose_key
        self.object_support_key, self.obstacle_motion_key = object_support_key, obstacle_motion_key
        self.tool_key = tool_key
        self.previous_key, self.stalled_key = previous_key, stalled_key
        self._seen: dict[int, tuple[NDArray[np.uint8], NDArray[np.float32]]] = {}

    def describe(self) -> dict[str, Any]:
        """Distances that are kept, and where moving obstacles turn round."""
        names = ("clearance", "object_clearance", "edge", "patrol_area")
        return {"contact_filter": {name: getattr(self, name) for name in names}}

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        # TorchRL puts back the old values of scenes that are not being reset.
        pose = read_key(tensordict_reset, self.object_pose_key, 3)
        tensordict_reset.set(self.stalled_key, _at_rest(pose[..., :2]))
        return tensordict_reset.set(self.previous_key, pose.clone())

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        pose = read_key(tensordict, self.object_pose_key, 3)
        next_tensordict.set(self.stalled_key, self._stalled(tensordict, next_tensordict))
        return next_tensordict.set(self.previous_key, pose.clone())

    def _stalled(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> torch.Tensor:
        """Place where the object stays, and the number of steps there, `[..., 3]`."""
        before = tensordict.get(self.stalled_key, None)
        if before is None:
            before = _at_rest(read_key(tensordict, self.object_pose_key, 3)[..., :2])
        place, steps = before.split([2, 1], -1)
        here = read_key(next_tensordict, self.object_pose_key, 3)[..., :2]
        stays = (here - place).norm(dim=-1, keepdim=True) <= _STAYS
        return torch.where(stays, torch.cat([place, steps + 1], -1), _at_rest(here))

    def transform_observation_spec(self, observation_spec: TensorSpec) -> TensorSpec:
        """Add the previous pose, and where the object stays."""
        check_spec_has(observation_spec, self.in_keys)
        add_unbounded(observation_spec, self.previous_key, 3)
        add_unbounded(observation_spec, self.stalled_key, 3)
        return observation_spec

    def _inv_call(self, tensordict: TensorDictBase) -> TensorDictBase:
        action = read_key(tensordict, self.action_key, 3)
        filtered = self.filter(tensordict, action)
        return tensordict.set(self.action_key, filtered)

    def filter(self, tensordict: TensorDictBase, action: torch.Tensor) -> torch.Tensor:
        """The actions that are taken instead of given ones in the base frame, `[..., 3]`.

        Raises:
            KeyError: If a key is missing.
        """
        filtered = _rows(action).clip(-1.0, 1.0)
        for i, scene in enumerate(self.scenes(tensordict)):
            filtered[i] = nearest_action(filtered[i], scene)
        return torch.as_tensor(filtered, dtype=action.dtype, device=action.device).view_as(action)

    def scenes(self, tensordict: TensorDictBase) -> list[PushedScene]:
        """Each scene as the functions of `push_prediction` and `predicted_contact` take it.

        Raises:
            KeyError: If a key is missing.
        """
        keys = (self.object_pose_key, self.ee_pose_key, self.object_support_key)
        poses, tips, supports = (_rows(read_key(tensordict, key)) for key in keys)
        bits = read_key(tensordict, self.blocked_key)
        cells = bits.detach().cpu().numpy().reshape(-1, *bits.shape[-2:])
        motion = tensordict.get(self.obstacle_motion_key, None)
        motions = np.zeros((len(poses), 4)) if motion is None else _rows(motion)
        before = tensordict.get(self.previous_key, None)
        steps = poses - (poses if before is None else _rows(before))
        steps[:, 2] = np.remainder(steps[:, 2] + np.pi, 2 * np.pi) - np.pi
        stalled = tensordict.get(self.stalled_key, None)
        waited = np.zeros(len(poses)) if stalled is None else _rows(stalled)[:, 2] * self._step_time
        kept = 1.0 - np.clip((waited - _PATIENCE) / _RELEASE, 0.0, 1.0)
        # Friction turns a disc with the same pressure everywhere as if at two thirds of its radius.
        levers = supports.max(-1) * 2 / 3
        tools = np.tile(self._tool, (len(poses), 1))
        if tensordict.get(self.tool_key, None) is not None:
            tools = _rows(read_key(tensordict, self.tool_key, 2))
        around, grid = directions(supports.shape[-1]), self._grid()
        distances = [self._distances(i, cells[i], motions[i]) for i in range(len(poses))]
        return [
            PushedScene(
                object_pose=poses[i],
                velocity=steps[i],
                tip_pose=tips[i],
                support=supports[i],
                outline=_outline(supports[i].tobytes()),
                directions=around,
                lever=float(levers[i]),
                tool=self._tool,
                low_tool=_rectangle(*tools[i].tolist()),
                distances=distances[i][0],
                moving=distances[i][1],
                grid=grid,
                drift=motions[i, 2:] * self._step_time,
                turn=self._time_to_turn(motions[i]) / self._step_time,
                ahead=math.ceil(_AHEAD / self._step_time),
                slack=math.ceil(_SLACK / self._step_time),
                inner=self._bounds + kept[i] * self._inward,
                motion=self._motion,
                slowing=_FRICTION * _GRAVITY * self._step_time**2,
                clearance=self.clearance,
                object_clearance=self.object_clearance * float(kept[i]),
            )
            for i in range(len(poses))
        ]

    def _time_to_turn(self, motion: NDArray[np.float64]) -> float:
        area = self.patrol_area
        return math.inf if area is None else area.time_to_edge(motion[:2], motion[2:])

    def _grid(self) -> NDArray[np.float64]:
        """Column and row of the base frame's origin and cells per metre."""
        u, v = self.camera.project(np.zeros(2))
        return np.array([u, v, 1.0 / self.camera.cell_size])

    def _distances(
        self, scene: int, bits: NDArray[np.uint8], motion: NDArray[np.float64]
    ) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Distance of each cell from what stands, and from the obstacle that moves, `[H, W]` [m].

        The second is `[0, 0]` where none moves. The first is kept while nothing of it changes.
        """
        standing = unpack_cells(bits, self.camera.width)
        moving = np.zeros((0, 0), np.float32)
        if motion[2:].any():
            cells = cells_at(standing, motion[:2], self.camera)
            standing, moving = standing & ~cells, self._away(cells)
        seen = self._seen.get(scene)
        if seen is None or not np.array_equal(seen[0], standing):
            seen = self._seen[scene] = standing, self._away(standing)
        return seen[1], moving

    def _away(self, blocked: NDArray[np.uint8]) -> NDArray[np.float32]:
        """Distance of each cell from the nearest blocked one, `[H, W]` [m]; 1 m where there is none."""
        if not blocked.any():
            return np.ones(blocked.shape, np.float32)
        free = np.ascontiguousarray(1 - blocked)
        away = cv2.distanceTransform(free, cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
        return (away * self.camera.cell_size).astype(np.float32)


def _at_rest(place: torch.Tensor) -> torch.Tensor:
    """A place `[..., 2]`, and no steps there, `[..., 3]`."""
    return torch.cat([place, torch.zeros_like(place[..., :1])], -1)


def _rows(values: torch.Tensor) -> NDArray[np.float64]:
    return values.detach().double().cpu().numpy().reshape(-1, values.shape[-1])


@functools.lru_cache(maxsize=256)
def _rectangle(half_length: float, half_width: float) -> NDArray[np.float64]:
    """Points on the outline of a rectangle."""
    return outline(np.abs(directions(48)) @ np.array([half_length, half_width]))


@functools.lru_cache(maxsize=256)
def _outline(support: bytes) -> NDArray[np.float64]:
    """Points on the outline of an object with this support function."""
    return outline(np.frombuffer(support))
