"""Where the tool goes when the arm hides the object."""

import math
from types import SimpleNamespace

import numpy as np
import pytest

from modpush.deploy.perception import Perceived
from modpush.deploy.place_aside import place_aside
from modpush.deploy.tracker import ObjectEstimate
from modpush.envs.robot.control import MotionConfig
from modpush.envs.robot.named import ROBOTS, TOOLS
from modpush.envs.robot.robot import Robot

HEIGHT, NOTHING = 0.02, np.zeros((0, 2))
TIP, OBJECT = (0.50, 0.0, 0.0), (0.45, 0.0, 0.0)


def tip_of(robot: Robot, joints) -> np.ndarray:
    return robot.link_transforms(joints)[-1][:2, 3]


def place(hidden, obstacles=NOTHING, tip=TIP, motion=None):
    """The place for a function of the tip's place that says how much is hidden."""
    robot, tool = ROBOTS["ur5"], TOOLS["2f85"]
    perception = SimpleNamespace(
        robot=robot,
        tool=tool,
        hidden_by_arm=lambda pose, joints: hidden(*tip_of(robot, joints)),
        obstacle_cells=lambda: obstacles,
    )
    estimate = ObjectEstimate(OBJECT, residual=0.0, hidden=1.0, found=False, unseen_for=15)
    view = np.zeros((2, 2))
    seen = Perceived(view, view.astype(np.uint8), estimate, tip, view.astype(bool))
    joints = np.array(robot.home)
    return place_aside(perception, seen, joints, HEIGHT, motion or MotionConfig())


def test_it_is_the_nearest_place_from_which_enough_is_seen() -> None:
    x, y = place(lambda x, y: 0.1 if y > 0.05 else 1.0)
    assert math.hypot(x - 0.50, y) == pytest.approx(0.10, abs=1e-6)
    assert y > 0.05
    x, y = place(lambda x, y: 0.1 if y < -0.12 else 1.0)  # too far for the nearer ones
    assert math.hypot(x - 0.50, y) == pytest.approx(0.18, abs=1e-6)
    assert y < -0.12


def test_of_several_it_is_that_where_least_is_hidden() -> None:
    _, y = place(lambda x, y: 0.9 - y)
    assert y == pytest.approx(
        0.18 * math.sin(math.radians(60)), abs=1e-6
    )  # 90 degrees slides along


def test_the_way_leads_away_from_the_object_and_from_obstacles() -> None:
    for hidden in (lambda x, y: 0.1, lambda x, y: x):
        x, _ = place(hidden)
        assert x > 0.50
    post = np.array([[0.58, 0.05]])
    x, y = place(lambda x, y: 0.4 - y, post)
    way = np.array([0.50, 0.0]) + np.linspace(0, 1, 50)[:, None] * np.array([x - 0.50, y])
    assert np.linalg.norm(way - post, axis=1).min() > 0.045


def test_none_leads_out_of_the_workspace_or_through_a_wall() -> None:
    narrow = MotionConfig(low=(0.40, -0.05), high=(0.55, 0.05))
    assert place(lambda x, y: 0.1, motion=narrow) is None
    angles = np.linspace(0, 2 * math.pi, 60)
    ring = np.array(TIP[:2]) + 0.06 * np.column_stack([np.cos(angles), np.sin(angles)])
    assert place(lambda x, y: 0.1, ring) is None
