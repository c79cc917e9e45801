"""`ContactFilter`: the nearest action by which nothing is predicted to run into an obstacle."""

from typing import Any

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from tensordict import NestedKey, TensorDictBase

from modpush._checks import read_key
from modpush._transforms import DescribedTransform
from modpush._types import NonNegative, Positive
from modpush._validation import checked_arguments
from modpush.geometry.camera import Camera, unpack_cells
from modpush.geometry.workspace import Rectangle
from modpush.mdp.predicted_contact import PushedScene, nearest_action, outline


class ContactFilter(DescribedTransform):
    """Replaces actions after which tool or object are predicted to touch an obstacle, or to leave.

    For every action it predicts the tool's outline after half of the step, all of it, and one and a half
    of it. Where that covers the object, the object is pushed out of it on the shortest way, without a
    turn. If then the tool or the pushed object is nearer to an obstacle than `clearance`, or the
    object's centre has been pushed nearer than `edge` to where an episode ends, the nearest of 175 other
    actions takes its place, where violations are added to its distance as a cost. An action without such
    a prediction is only clipped to [-1, 1]. Obstacles that move count where they are and where they will
    be.

    Like `ActionFrame`, it works on the way to the environment, after the action has been turned into
    the base frame: put it before `ActionFrame`. What is stored is the agent's own action. It reads what
    the agent observes, obstacles from the depth image, and prevents no contact that only comes from an
    obstacle which moves against a standing object.

    Args:
        tool_half_extents: Half of the sides of the tool's tip along its x and y [m].
        bounds: Lower and upper corner (x, y) of the area in which the object's centre may be [m].
        max_step: Motion of the tool along each axis by an action of 1 [m].
        max_turn: Turn of the tool by an action of 1 [rad].
        step_time: Duration of a control step [s].
        clearance: Smallest predicted distance of tool and object from obstacles [m].
        edge: Smallest predicted distance of a pushed object's centre from the edge of `bounds` [m].
        camera: The camera whose grid the blocked cells are on.
        action_key: Read and replaced on its way, `[..., 3]` (dx, dy, dyaw) in [-1, 1], base frame.
        blocked_key: Read, `[..., H, N]` uint8: blocked cells as bits, as `OccupancyGrid` writes them.
        object_pose_key: Read, `[..., 3]` (x, y, yaw) [m, rad].
        ee_pose_key: Read, `[..., 3]` (x, y, yaw) of the tool's tip [m, rad].
        object_support_key: Read, `[..., n]`: how far the object reaches in n directions of its own [m].
        obstacle_motion_key: Read where it is there, `[..., 4]`: place and velocity (x, y) of an obstacle
            [m, m/s].

    Raises:
        ValueError: If a number is out of its range.
        KeyError: If a key is missing when an action is filtered.
    """

    @checked_arguments
    def __init__(
        self,
        tool_half_extents: tuple[Positive, Positive],
        bounds: Rectangle,
        *,
        max_step: Positive = 0.02,
        max_turn: Positive = 0.05,
        step_time: Positive = 1 / 15,
        clearance: NonNegative = 0.006,
        edge: NonNegative = 0.02,
        camera: Camera | None = None,
        action_key: NestedKey = "action",
        blocked_key: NestedKey = "blocked_bits",
        object_pose_key: NestedKey = "object_pose",
        ee_pose_key: NestedKey = "ee_pose",
        object_support_key: NestedKey = "object_support",
        obstacle_motion_key: NestedKey = "obstacle_motion",
    ) -> None:
        super().__init__(in_keys_inv=[action_key], out_keys_inv=[action_key])
        self.clearance, self.edge = clearance, edge
        self.camera = camera or Camera()
        self._motion = np.array([max_step, max_step, max_turn])
        self._tool, self._step_time = np.array(tool_half_extents), step_time
        (x0, y0), (x1, y1) = bounds
        self._inner = np.array([x0 + edge, y0 + edge, x1 - edge, y1 - edge])
        self.action_key, self.blocked_key = action_key, blocked_key
        self.object_pose_key, self.ee_pose_key = object_pose_key, ee_pose_key
        self.object_support_key, self.obstacle_motion_key = object_support_key, obstacle_motion_key
        self._seen: dict[int, tuple[NDArray[np.uint8], NDArray[np.float32]]] = {}

    def describe(self) -> dict[str, Any]:
        """Distances that are kept."""
        return {"contact_filter": {"clearance": self.clearance, "edge": self.edge}}

    def _inv_call(self, tensordict: TensorDictBase) -> TensorDictBase:
        action = read_key(tensordict, self.action_key, 3)
        filtered = self.filter(tensordict, action)
        return tensordict.set(self.action_key, filtered)

    def filter(self, tensordict: TensorDictBase, action: torch.Tensor) -> torch.Tensor:
        """The actions that are taken instead of given ones in the base frame, `[..., 3]`.

        Raises:
            KeyError: If a key is missing.
        """
        keys = (self.object_pose_key, self.ee_pose_key, self.object_support_key)
        poses, tips, supports = (_rows(read_key(tensordict, key)) for key in keys)
        bits = read_key(tensordict, self.blocked_key)
        cells = bits.detach().cpu().numpy().reshape(-1, *bits.shape[-2:])
        motion = tensordict.get(self.obstacle_motion_key, None)
        velocities = np.zeros((len(poses), 2)) if motion is None else _rows(motion)[:, 2:]
        radii, grid, filtered = outline(supports), self._grid(), _rows(action).copy()
        for i in range(len(poses)):
            scene = PushedScene(
                object_pose=poses[i],
                tip_pose=tips[i],
                support=supports[i],
                outline=radii[i],
                tool=self._tool,
                distances=self._distances(i, cells[i]),
                grid=grid,
                drift=velocities[i] * self._step_time,
                inner=self._inner,
                motion=self._motion,
                clearance=self.clearance,
            )
            filtered[i] = nearest_action(np.clip(filtered[i], -1.0, 1.0), scene)
        return torch.as_tensor(filtered, dtype=action.dtype, device=action.device).view_as(action)

    def _grid(self) -> NDArray[np.float64]:
        """Column and row of the base frame's origin and cells per metre."""
        u, v = self.camera.project(np.zeros(2))
        return np.array([u, v, 1.0 / self.camera.cell_size])

    def _distances(self, scene: int, bits: NDArray[np.uint8]) -> NDArray[np.float32]:
        """Distance of each cell from the nearest blocked one, `[H, W]` [m]; kept while none changes."""
        seen = self._seen.get(scene)
        if seen is not None and np.array_equal(seen[0], bits):
            return seen[1]
        blocked = unpack_cells(bits, self.camera.width)
        distances = np.full(blocked.shape, np.inf, dtype=np.float32)
        if blocked.any():
            free = np.ascontiguousarray(1 - blocked)
            distances = cv2.distanceTransform(free, cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
            distances = (distances * self.camera.cell_size).astype(np.float32)
        self._seen[scene] = bits.copy(), distances
        return distances


def _rows(values: torch.Tensor) -> NDArray[np.float64]:
    return values.detach().double().cpu().numpy().reshape(-1, values.shape[-1])
