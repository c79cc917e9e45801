"""Prediction of a push: against hand-computed motions, and against MuJoCo."""

import math

import numpy as np
import pytest

from modpush.deploy.outlines import overlap
from modpush.deploy.push_motion import PushMotion, tool_outlines
from modpush.envs.scenes.objects import OBJECTS, PAPER_OBJECTS
from tests.deploy.scenes import ROBOT, TOOL, Bench

SQUARE = np.array([[0.01, 0.01], [-0.01, 0.01], [-0.01, -0.01], [0.01, -0.01]])


def square_at(x: float, y: float) -> np.ndarray:
    return SQUARE + np.array([x, y])


def test_overlap_of_squares_by_hand() -> None:
    depth, nx, ny, px, py = overlap(SQUARE, square_at(0.018, 0.004))
    # 2 mm of 20 mm overlap along x; they share y from -6 to 10 mm, in the middle between both sides.
    assert depth == pytest.approx(0.002)
    assert (nx, ny) == pytest.approx((1.0, 0.0))
    assert (px, py) == pytest.approx((0.009, 0.002))
    assert overlap(SQUARE, square_at(0.05, 0.0))[0] == pytest.approx(-0.03)


def test_a_push_through_the_middle_does_not_turn_the_object() -> None:
    motion = PushMotion(OBJECTS["small_cube"])
    before = [square_at(0.36, 0.0)]  # its side is at 0.37, the cube's at 0.375
    pose, gap = motion.predict(np.array([0.40, 0.0, 0.0]), before, [before[0] + (0.02, 0.0)])
    assert pose == pytest.approx([0.415, 0.0, 0.0], abs=1e-5)
    assert gap < 0


def test_a_tool_that_does_not_reach_the_object_moves_nothing() -> None:
    motion = PushMotion(OBJECTS["small_cube"])
    before = [square_at(0.34, 0.0)]
    pose, gap = motion.predict(np.array([0.40, 0.0, 0.3]), before, [before[0] + (0.005, 0.0)])
    assert pose.tolist() == [0.40, 0.0, 0.3]
    assert gap > 0.005


@pytest.mark.parametrize(("offset", "sense"), [(0.018, -1), (-0.018, 1)])
def test_a_push_beside_the_middle_turns_the_object(offset, sense) -> None:
    motion = PushMotion(OBJECTS["small_cube"])
    before = [square_at(0.36, offset)]
    pose, _ = motion.predict(np.array([0.40, 0.0, 0.0]), before, [before[0] + (0.02, 0.0)])
    assert sense * pose[2] > 0.05
    assert pose[0] < 0.415


@pytest.mark.parametrize("name", PAPER_OBJECTS)
def test_predictions_are_those_of_the_physics(name) -> None:
    """A push of 12 steps beside the middle: each step by itself, from the true pose before it."""
    bench, motion = Bench(method="rays"), PushMotion(OBJECTS[name])
    tool = np.array([0.45, -0.20, 0.0])
    joints = bench.load(name, (0.46, -0.12, 0.3), tool)
    apart, turned, moved = [], [], 0.0
    for _ in range(12):
        tool[1] += 0.012
        pose, flange = bench.object_pose(), ROBOT.link_transforms(joints)[-1]
        joints = bench.move(joints, tool)
        flanges = flange, ROBOT.link_transforms(joints)[-1]
        ends = [tool_outlines(TOOL, one, OBJECTS[name].height) for one in flanges]
        predicted, _ = motion.predict(pose, *ends)
        truth = bench.object_pose()
        moved += float(np.linalg.norm(truth[:2] - pose[:2]))
        apart.append(float(np.linalg.norm((predicted - truth)[:2])))
        turned.append(abs(math.remainder(predicted[2] - truth[2], math.tau)))
    assert moved > 0.05
    assert np.mean(apart) < 0.0025
    assert math.degrees(np.mean(turned)) < 4.0


def test_only_what_reaches_below_a_height_counts_as_the_tool() -> None:
    bench = Bench(method="rays")
    flange = ROBOT.link_transforms(bench.load("small_cube", (0.45, 0.0, 0.0), (0.4, -0.2, 0.0)))[-1]
    (finger,) = tool_outlines(TOOL, flange, 0.05)
    assert np.ptp(finger, axis=0) == pytest.approx([0.064, 0.022], abs=1e-3)
    assert finger.mean(0) == pytest.approx([0.4, -0.2], abs=1e-3)
    area = 0.5 * np.sum(
        finger[:, 0] * np.roll(finger[:, 1], -1) - finger[:, 1] * np.roll(finger[:, 0], -1)
    )
    assert area == pytest.approx(0.064 * 0.022, rel=1e-3)  # counter-clockwise
    assert tool_outlines(TOOL, flange, 0.01) == []
