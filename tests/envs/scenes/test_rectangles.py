import math

import numpy as np
import pytest

from modpush.envs.scenes.obstacle import Obstacle
from modpush.envs.scenes.rectangles import obstacle_distance


def test_obstacle_distance_by_hand() -> None:
    bar = Obstacle((0.4, 0.06, 0.06), (0.5, 0.0, math.pi / 2))  # 40 cm along y
    points = np.array([[0.5, 0.0], [0.63, 0.0], [0.5, 0.3], [0.56, 0.24]])
    expected = [0.0, 0.10, 0.10, math.hypot(0.03, 0.04)]
    assert obstacle_distance(points, [bar]) == pytest.approx(expected)
    assert np.isinf(obstacle_distance(points, [])).all()
