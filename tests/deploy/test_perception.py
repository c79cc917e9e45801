"""Perception on rendered, noisy images of MuJoCo: where things are, and what the policy's images show."""

import math

import numpy as np
import pytest

from modpush.deploy import Perception
from modpush.envs.depth.raycast import Solids, blank_image, draw
from modpush.envs.scenes.objects import OBJECTS, PAPER_OBJECTS
from modpush.envs.scenes.obstacle import Obstacle
from modpush.geometry import CAMERA as VIEW, Label
from modpush.geometry.shapes import box
from tests.deploy.scenes import CAMERA, FAR_AWAY, Bench, yaw_apart

BAR = Obstacle((0.30, 0.06, 0.06), (0.60, 0.15, 0.4))
BESIDE = Obstacle((0.20, 0.06, 0.06), (0.52, 0.10, 0.0))
OUT_OF_SIGHT = np.array([0.0, -math.pi / 2, 0.0, -math.pi / 2, 0.0, 0.0])  # the arm stands upright


@pytest.fixture(scope="module")
def bench() -> Bench:
    return Bench()


def assert_tracked(seen, truth, name: str, place: float = 0.005, yaw: float = 5.0) -> None:
    x, y, turn = seen.object.pose
    assert math.hypot(x - truth[0], y - truth[1]) < place
    apart = yaw_apart(turn, truth[2], OBJECTS[name].symmetry)
    assert math.degrees(apart) < yaw


@pytest.mark.parametrize("name", PAPER_OBJECTS)
def test_an_object_is_found_anywhere_among_obstacles(bench, name) -> None:
    perception = Perception(CAMERA, name)
    for pose in ((0.36, 0.15, 0.3), (0.60, -0.12, -2.0), (0.45, -0.05, 1.1)):
        joints = bench.load(name, pose, obstacles=[BAR])
        perception.reset()
        seen = perception.update(bench.image(), joints)
        assert seen.object.found
        assert seen.object.hidden < 0.3
        assert_tracked(seen, bench.object_pose(), name, 0.003, 3.0)


@pytest.mark.parametrize("name", PAPER_OBJECTS)
def test_a_pushed_object_is_followed(bench, name) -> None:
    """Along y, past an obstacle, with the finger between camera and object for some of the time."""
    perception = Perception(CAMERA, name)
    tool = np.array([0.45, -0.22, 0.0])
    joints = bench.load(name, (0.45, -0.10, 0.4), tool, [BAR])
    assert perception.update(bench.image(), joints).object.found
    unseen = 0
    for _ in range(16):
        tool[1] += 0.015
        joints = bench.move(joints, tool)
        seen = perception.update(bench.image(), joints)
        unseen = max(unseen, seen.object.unseen_for)
        if seen.object.hidden < 0.3:
            assert_tracked(seen, bench.object_pose(), name)
        assert_tracked(seen, bench.object_pose(), name, 0.02, 25.0)
    assert bench.object_pose()[1] > 0.0  # it was pushed
    assert unseen <= 15


def test_an_object_that_was_moved_away_is_found_again(bench) -> None:
    perception = Perception(CAMERA, "large_cube")
    joints = bench.load("large_cube", (0.45, 0.10, 0.3))
    perception.update(bench.image(), joints)
    joints = bench.load("large_cube", (0.62, -0.12, 1.2))
    found = [perception.update(bench.image(), joints).object for _ in range(5)]
    assert not found[0].found
    assert found[0].unseen_for == 1
    assert found[-1].found
    assert found[-1].unseen_for == 0
    assert np.linalg.norm(np.array(found[-1].pose[:2]) - (0.62, -0.12)) < 0.003


def test_an_object_that_is_not_there_is_not_found(bench) -> None:
    joints = bench.load("small_cube", (0.45, 0.10, 0.3), obstacles=[BAR])
    assert Perception(CAMERA, "fragment").update(bench.image(), joints) is None
    empty = np.zeros((480, 640), np.float32)
    assert Perception(CAMERA, "small_cube").update(empty, joints) is None


def test_a_guess_says_which_of_several_alike_things_is_the_object(bench) -> None:
    alike = Obstacle((0.05, 0.05, 0.05), (0.62, -0.15, 0.0))
    joints = bench.load("small_cube", (0.42, 0.12, 0.3), obstacles=[alike])
    perception = Perception(CAMERA, "small_cube")
    for place in ((0.42, 0.12), (0.62, -0.15)):
        perception.reset((place[0] + 0.02, place[1] - 0.02, 0.3))
        seen = perception.update(bench.image(), joints)
        assert np.linalg.norm(np.array(seen.object.pose[:2]) - place) < 0.003
    perception.reset((0.30, 0.30))
    assert perception.update(bench.image(), joints) is None
    for guess in ((0.4,), (0.4, float("nan"))):
        with pytest.raises(ValueError, match="guess must be 2 or 3 finite numbers"):
            perception.reset(guess)


@pytest.mark.parametrize("name", ["small_cube", "fragment"])
def test_a_pose_that_was_wrong_while_the_object_was_hidden_is_corrected(bench, name) -> None:
    perception = Perception(CAMERA, name)
    joints = bench.load(name, (0.45, 0.10, 0.3))
    perception.update(bench.image(), joints)
    covered = np.zeros((480, 640), np.float32)
    for _ in range(3):
        assert not perception.update(covered, joints).object.found
    joints = bench.load(name, (0.465, 0.11, 1.9))
    seen = perception.update(bench.image(), joints)
    assert seen.object.found
    assert_tracked(seen, bench.object_pose(), name)


def test_the_arm_hides_what_is_behind_it_as_seen_from_the_camera(bench) -> None:
    perception = Perception(CAMERA, "small_cube")
    joints = bench.load("small_cube", (0.40, 0.0, 0.0), (0.46, 0.02, 0.0))
    pose = np.array([0.40, 0.0, 0.0])
    hidden = perception.hidden_by_arm(pose, joints)
    seen = perception.update(bench.image(), joints)
    assert hidden > 0.5
    assert seen is None or seen.object.hidden == pytest.approx(hidden, abs=0.05)
    assert perception.hidden_by_arm(pose, OUT_OF_SIGHT) == 0.0


def expected_images(name: str, pose, obstacles) -> tuple[np.ndarray, np.ndarray]:
    depth, labels = blank_image()
    things = [(box(*o.size), o.pose, o.size[2], Label.OBSTACLE) for o in obstacles]
    for shape, (x, y, yaw), height, label in things:
        at = np.array([[x, y, height / 2, math.cos(yaw / 2), 0.0, 0.0, math.sin(yaw / 2)]])
        draw(depth, labels, Solids.of([shape]), at, label)
    x, y, yaw = pose
    height = OBJECTS[name].height
    at = np.array([[x, y, height / 2, math.cos(yaw / 2), 0.0, 0.0, math.sin(yaw / 2)]])
    draw(depth, labels, Solids.of(OBJECTS[name].parts), at, Label.OBJECT)
    return depth, labels


def test_the_policy_s_images_are_those_of_its_own_camera(bench) -> None:
    """With the arm away at first; then it hides an obstacle, which is remembered."""
    perception = Perception(CAMERA, "small_cube")
    joints = bench.load("small_cube", (0.45, 0.20, 0.3), (0.52, -0.02, 0.0), [BESIDE])
    expected, labels = expected_images("small_cube", (0.45, 0.20, 0.3), [BESIDE])
    model, data = bench.engine.simulation
    import mujoco

    state = data.qpos[:6].copy()
    data.qpos[:6] = OUT_OF_SIGHT
    mujoco.mj_forward(model, data)
    for _ in range(4):
        perception.update(bench.image(), OUT_OF_SIGHT)
    data.qpos[:6] = state
    mujoco.mj_forward(model, data)
    seen = perception.update(bench.image(), joints)
    assert seen.depth.shape == expected.shape
    high = expected < VIEW.z - 0.013
    assert (labels == Label.OBSTACLE).sum() > 500
    # An obstacle's outline is found to a pixel, 3.6 mm.
    import cv2

    core = cv2.erode(high.astype(np.uint8), np.ones((3, 3))).astype(bool)
    wide = cv2.dilate(high.astype(np.uint8), np.ones((5, 5))).astype(bool)
    assert np.quantile(np.abs(seen.depth - expected)[core], 0.99) < 0.012
    assert np.median(np.abs(seen.depth - expected)[core]) < 0.003
    assert (seen.depth[~wide] == np.float32(VIEW.z)).mean() > 0.999
    same = seen.segmentation == labels
    assert same[core | ~wide].mean() > 0.999
    assert set(np.unique(seen.segmentation)) == {Label.TABLE, Label.OBJECT, Label.OBSTACLE}


def test_a_reset_forgets_the_obstacles(bench) -> None:
    perception = Perception(CAMERA, "small_cube")
    joints = bench.load("small_cube", (0.42, -0.05, 0.3), obstacles=[BAR])
    seen = perception.update(bench.image(), joints)
    assert (seen.segmentation == Label.OBSTACLE).any()
    joints = bench.load("small_cube", (0.42, -0.05, 0.3))
    perception.reset()
    seen = perception.update(bench.image(), joints)
    assert not (seen.segmentation == Label.OBSTACLE).any()


def test_the_tip_is_where_the_joints_say(bench) -> None:
    joints = bench.load("small_cube", (0.42, 0.05, 0.3))
    seen = Perception(CAMERA, "small_cube").update(bench.image(), joints)
    assert seen.tip_pose == pytest.approx(FAR_AWAY, abs=1e-4)


@pytest.mark.parametrize(
    ("depth", "joints", "message"),
    [
        (np.zeros((240, 320), np.float32), np.zeros(6), r"depth must be \[480, 640\]"),
        (np.zeros((480, 640), np.float32), np.zeros(7), "joints must be 6"),
        (np.zeros((480, 640), np.float32), np.full(6, np.nan), "finite"),
    ],
)
def test_wrong_images_and_joints_are_refused(depth, joints, message) -> None:
    with pytest.raises(ValueError, match=message):
        Perception(CAMERA, "small_cube").update(depth, joints)
