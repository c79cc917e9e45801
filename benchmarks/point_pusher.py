"""A pushing task small enough to learn in minutes: a point pushes a disc to a goal.

Quasi-static: where the point would enter the disc, the disc moves out of its way along the line
between them, so steering takes going round the disc. All lengths in metres on a table of 2 by 2.
"""

from typing import Any, ClassVar

import gymnasium as gym
import numpy as np

STEP, DISC_RADIUS, GOAL_RADIUS, SUBSTEPS, MAX_STEPS = 0.08, 0.15, 0.12, 4, 60


class PointPusher(gym.Env):
    """Observation `[10]`: point, disc, goal, disc - point, goal - disc. Action `[2]` in [-1, 1]."""

    metadata: ClassVar[dict[str, Any]] = {"render_modes": []}

    def __init__(self) -> None:
        self.observation_space = gym.spaces.Box(-4, 4, (10,), np.float32)
        self.action_space = gym.spaces.Box(-1, 1, (2,), np.float32)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None):
        super().reset(seed=seed)
        self._steps = 0
        self._disc = self.np_random.uniform(-0.5, 0.5, 2)
        angle = self.np_random.uniform(-np.pi, np.pi, 2)
        distance = self.np_random.uniform(0.3, 0.5)
        self._goal = self._disc + distance * np.array([np.cos(angle[0]), np.sin(angle[0])])
        self._point = self._disc + 0.35 * np.array([np.cos(angle[1]), np.sin(angle[1])])
        return self._observe(), {}

    def step(self, action: np.ndarray):
        for _ in range(SUBSTEPS):
            self._point = np.clip(self._point + action * STEP / SUBSTEPS, -1, 1)
            offset = self._disc - self._point
            gap = float(np.linalg.norm(offset))
            if gap < DISC_RADIUS:
                self._disc = self._point + DISC_RADIUS * offset / max(gap, 1e-6)
        self._steps += 1
        to_goal = float(np.linalg.norm(self._goal - self._disc))
        to_disc = float(np.linalg.norm(self._disc - self._point)) - DISC_RADIUS
        success = to_goal < GOAL_RADIUS
        reward = 5.0 if success else -to_goal - 0.5 * to_disc
        truncated = self._steps >= MAX_STEPS and not success
        return self._observe(), reward, success, truncated, {"success": success}

    def _observe(self) -> np.ndarray:
        parts = (self._point, self._disc, self._goal)
        relative = (self._disc - self._point, self._goal - self._disc)
        return np.concatenate([*parts, *relative]).astype(np.float32)


gym.register("PointPusher-v0", entry_point=PointPusher)
