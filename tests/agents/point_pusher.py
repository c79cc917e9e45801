"""A quasi-static world to try controllers in: a disc tool pushes a disc among obstacles.

The object moves only where the tool overlaps it, straight away from the tool's centre by as much as
they overlap; obstacles stop it. No friction, no rotation: what a point pusher does to a disc.
"""

import numpy as np
import torch
from tensordict import TensorDict
from torch import Tensor

from modpush.geometry import Camera, Label

TOOL, OBJECT = 0.01, 0.03  # radii [m]


class PointPusher:
    """`B` scenes without obstacles, or all with the same boxes (x from, x to, y from, y to) [m]."""

    def __init__(self, start: Tensor, goal: Tensor, tool: Tensor, boxes=()) -> None:
        self.object, self.goal, self.tool = start.clone(), goal, tool.clone()
        self.boxes, self.camera = boxes, Camera()
        rows, columns = torch.meshgrid(torch.arange(256), torch.arange(256), indexing="ij")
        self.cells = self.camera.unproject(torch.stack([columns, rows], -1))
        self.blocked = torch.zeros(256, 256, dtype=torch.bool)
        for x0, x1, y0, y1 in boxes:
            x, y = self.cells[..., 0], self.cells[..., 1]
            self.blocked |= (x >= x0) & (x <= x1) & (y >= y0) & (y <= y1)

    def observe(self) -> TensorDict:
        count = len(self.object)
        depth = torch.full((count, 1, 256, 256), 1.1)
        segments = torch.zeros(count, 1, 256, 256, dtype=torch.uint8)
        # Flat obstacles just high enough to block: then the image is the map.
        depth[:, 0, self.blocked] = 1.1 - 0.02
        segments[:, 0, self.blocked] = Label.OBSTACLE
        for b in range(count):
            disc = (self.cells - self.object[b]).norm(dim=-1) <= OBJECT
            depth[b, 0, disc] = 1.1 - 0.05
            segments[b, 0, disc] = Label.OBJECT
        zero = torch.zeros(count, 1)
        return TensorDict(
            depth=depth,
            segmentation=segments,
            object_pose=torch.cat([self.object, zero], -1),
            ee_pose=torch.cat([self.tool, zero], -1),
            goal_position=self.goal.clone(),
            object_radius=torch.full((count, 1), OBJECT),
            batch_size=[count],
        )

    def step(self, action: Tensor) -> None:
        for _ in range(4):
            self.tool = self.tool + 0.02 / 4 * action[:, :2].clamp(-1, 1)
            away = self.object - self.tool
            distance = away.norm(dim=-1, keepdim=True)
            depth = (TOOL + OBJECT - distance).clamp_min(0)
            moved = self.object + depth * away / distance.clamp_min(1e-9)
            for b in range(len(moved)):
                if self._free(moved[b]):
                    self.object[b] = moved[b]
                elif depth[b] > 0:  # the object does not give way: nor can the tool go on
                    self.tool[b] = self.object[b] - away[b] / distance[b] * (TOOL + OBJECT)

    def _free(self, position: Tensor) -> bool:
        for x0, x1, y0, y1 in self.boxes:
            nearest = torch.tensor(
                [np.clip(float(position[0]), x0, x1), np.clip(float(position[1]), y0, y1)]
            )
            if (position - nearest).norm() < OBJECT:
                return False
        return True

    def reached(self) -> Tensor:
        return (self.object - self.goal).norm(dim=-1) < 0.05
