"""`MovingObstacles`: the obstacles of a batch of scenes that move by themselves."""

from collections.abc import Sequence

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from modpush.envs.scenes.obstacle import Obstacle
from modpush.envs.scenes.rectangles import obstacle_distance


class MovingObstacles:
    """Places and velocities of the obstacles with a motion, from the time of each scene's episode."""

    def __init__(self, num_envs: int, control_freq: int, substeps: int) -> None:
        self.steps: NDArray[np.int64] = np.zeros(num_envs, dtype=np.int64)
        """Number of control steps since the start of each scene's episode, `[B]`."""
        self._control_freq, self._substeps = control_freq, substeps
        self._obstacles: list[list[Obstacle]] = [[] for _ in range(num_envs)]

    def begin(self, index: int, layout: Sequence[Obstacle]) -> None:
        """Take over the layout of a scene; its `steps` are set by the caller."""
        self._obstacles[index] = [o for o in layout if o.motion is not None]

    def targets(self, index: int) -> tuple[NDArray[np.float64], ...]:
        """The argument `obstacles` of `Engine.advance`; no argument where no obstacle moves."""
        obstacles, substeps = self._obstacles[index], self._substeps
        if not obstacles:
            return ()
        physics_steps = self.steps[index] * substeps + np.arange(1, substeps + 1)
        time = physics_steps / (self._control_freq * substeps)
        return (np.stack([obstacle.at(time) for obstacle in obstacles], axis=1),)

    def nearest(self, object_position: NDArray[np.float64]) -> Tensor:
        """Place [m] and velocity [m/s] of the moving obstacle that is nearest to places `[B, 2]` [m].

        `[B, 4]` float32; zeros where there is none.
        """
        found = np.zeros((len(self._obstacles), 4))
        for i, obstacles in enumerate(self._obstacles):
            time, place = self.steps[i] / self._control_freq, object_position[i]
            gaps = [float(obstacle_distance(place, [o.standing(time)])) for o in obstacles]
            if gaps:
                found[i] = obstacles[int(np.argmin(gaps))].at(time)
        return torch.from_numpy(found.astype(np.float32))
