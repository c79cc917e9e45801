"""The local window: where things are in it, what is removed, and that it moves with the scene."""

import importlib
import math

import pytest
import torch
from hypothesis import given, settings, strategies as st

from modpush.encoders import egocentric_window
from modpush.envs import PushEnv
from modpush.geometry import Camera, Label
from tests.encoders.scenes import CUBE, image, moved, window_of

module = importlib.import_module("modpush.encoders.window")
MIDDLE = (0.60, 0.0, 0.0)  # under the camera
BAR = (0.10, 0.06, 0.06)
PIXEL = Camera().cell_size


def blocked_at(window):
    """Mean (row, column) of what stands in a window."""
    return (window[0, 0] > 0.2).nonzero().double().mean(0).tolist()


@pytest.mark.parametrize(
    ("offset", "row", "column"),
    [
        ((0.07, 0.0), 31.5 - 0.07 / PIXEL, 31.5),  # ahead is up
        ((0.0, 0.07), 31.5, 31.5 - 0.07 / PIXEL),  # left is left
        ((-0.07, -0.06), 31.5 + 0.07 / PIXEL, 31.5 + 0.06 / PIXEL),
    ],
)
@pytest.mark.parametrize("yaw", [0.0, 0.7, math.pi / 2, -2.0])
def test_up_is_ahead_and_left_is_left_of_the_object(offset, row, column, yaw):
    obstacle = moved((CUBE, (*offset, 0.0)), (0.5, 0.1), yaw)
    pushed = (CUBE, (0.5, 0.1, yaw))
    seen_row, seen_column = blocked_at(window_of([obstacle], pushed))
    assert seen_row == pytest.approx(row, abs=0.6)
    assert seen_column == pytest.approx(column, abs=0.6)


def test_a_value_is_the_height_over_eight_centimetres():
    bar = ((0.30, 0.06, 0.06), (0.68, 0.0, math.pi / 2))
    values = window_of([bar], (CUBE, MIDDLE)).unique()
    torch.testing.assert_close(values, torch.tensor([0.0, 0.75]), atol=1e-5, rtol=0)
    tall = ((0.30, 0.06, 0.20), (0.68, 0.0, math.pi / 2))
    assert window_of([tall], (CUBE, MIDDLE)).max() == 1.0
    assert window_of([bar], (CUBE, MIDDLE), max_height=0.12).max() == pytest.approx(0.5, abs=1e-5)


def test_the_size_of_an_obstacle_is_true_in_pixels_of_the_table():
    window = window_of([(BAR, (0.60, 0.25, 0.0))], (CUBE, (0.55, 0.25, 0.0)))
    rows, columns = (window[0, 0] > 0.2).nonzero().unbind(1)
    assert rows.max() - rows.min() + 1 == pytest.approx(0.10 / PIXEL, abs=1)
    assert columns.max() - columns.min() + 1 == pytest.approx(0.06 / PIXEL, abs=1)


@pytest.mark.parametrize("where", [(0.60, 0.0), (0.25, 0.3), (0.72, -0.3)])
def test_nothing_of_the_object_is_left(where):
    for yaw in (0.0, 0.4, 1.1):
        assert (window_of([], ((0.08, 0.05, 0.06), (*where, yaw))) == 0).all()


def test_the_robot_is_removed_and_obstacles_beside_the_object_are_not():
    depth, labels = image([(CUBE, (0.60, 0.055, 0.0))], (CUBE, MIDDLE))
    pose = torch.tensor([MIDDLE])
    window = egocentric_window(depth, labels, pose)
    assert (window > 0.2).sum() == pytest.approx((0.05 / PIXEL) ** 2, rel=0.05)
    labels[labels == Label.OBSTACLE] = Label.ROBOT
    assert (egocentric_window(depth, labels, pose) == 0).all()
    assert egocentric_window(depth, None, pose).max() > 0.6  # nothing said, nothing removed


@settings(max_examples=25, deadline=None, derandomize=True)
@given(
    x=st.floats(0.42, 0.78),
    y=st.floats(-0.2, 0.2),
    turn=st.floats(-math.pi, math.pi),
    bearing=st.floats(-math.pi, math.pi),
    bar_yaw=st.floats(0.0, math.pi),
)
def test_turning_and_shifting_the_whole_scene_changes_edge_pixels_only(
    x, y, turn, bearing, bar_yaw
):
    obstacles = [
        (BAR, (0.09 * math.cos(bearing), 0.09 * math.sin(bearing), bar_yaw)),
        (CUBE, (0.10 * math.cos(bearing + 2.5), 0.10 * math.sin(bearing + 2.5), 0.3)),
    ]
    here = window_of([moved(o, MIDDLE[:2], 0.0) for o in obstacles], (CUBE, MIDDLE))
    there = window_of([moved(o, (x, y), turn) for o in obstacles], (CUBE, (x, y, turn)))
    differ = (here - there).abs()[0, 0] > 0.02
    # Only where an edge runs through a pixel may the two differ; where one obstacle hides a corner
    # of the other's foot, a pixel or two more.
    raised = (here > 0.2).float()
    grown = torch.nn.functional.max_pool2d(raised, 3, 1, 1)
    shrunk = -torch.nn.functional.max_pool2d(-raised, 3, 1, 1)
    assert (differ & (grown == shrunk)[0, 0]).sum() <= 4
    assert differ.sum() <= 0.15 * raised.sum() + 2


def test_standing_upright_is_what_makes_it_independent_of_the_place():
    def seen(where, upright):
        bar = (BAR, (where[0], where[1] + 0.09, 0.0))
        return window_of([bar], (CUBE, (*where, 0.0)), upright=upright)

    def differing(upright):
        change = seen((0.6, 0.0), upright) - seen((0.6, 0.22), upright)
        return (change.abs() > 0.02).sum().item()

    assert differing(True) <= 28  # one pixel along each side of the bar's 28
    assert differing(False) > 3 * 28


@pytest.fixture(scope="module")
def env():
    env = PushEnv(
        6, scene=["maze", "slot", "random_clutter"], clearance=0.0, arm_in_depth=True, seed=3
    )
    yield env
    env.close()


@pytest.fixture
def two_threads():
    torch.set_num_threads(2)
    yield
    torch.set_num_threads(1)


@pytest.mark.usefixtures("two_threads")
def test_many_scenes_are_the_same_as_one_by_one(monkeypatch):
    kernel, batches = module.write_windows, []
    parallel = kernel._parallel
    monkeypatch.setattr(
        kernel, "_parallel", lambda b, *rest: batches.append(b) or parallel(b, *rest)
    )
    depth, labels = image([(BAR, (0.66, 0.03, 0.3))], (CUBE, MIDDLE))
    pose = torch.rand(70, 3) * 0.2 + torch.tensor([0.5, -0.1, 0.0])
    many = egocentric_window(depth.expand(70, -1, -1), labels.expand(70, -1, -1), pose)
    for b in range(0, 70, 3):
        assert torch.equal(many[b], egocentric_window(depth, labels, pose[b : b + 1])[0])
    assert batches == [70]  # only the many are made by the parallel kernel


def test_what_lies_beyond_the_image_is_free_or_blocked():
    depth, labels = image([])
    pose = torch.tensor([[0.60 + 128 * PIXEL, 0.0, 0.0]])  # the image's upper edge
    assert (egocentric_window(depth, labels, pose) == 0).all()
    window = egocentric_window(depth, labels, pose, outside="blocked")
    assert (window[0, 0, :32] == 1).all()
    assert (window[0, 0, 32:] == 0).all()


@pytest.mark.parametrize("upright", [True, False])
def test_a_camera_of_twice_the_resolution_gives_the_same_window(env, upright):
    data = env.reset()
    images = [data["depth"][:, 0], data["segmentation"][:, 0]]
    doubled = [image.repeat_interleave(2, 1).repeat_interleave(2, 2) for image in images]
    for size in (64, 33):
        options = {"size": size, "outside": "blocked", "upright": upright}
        windows = egocentric_window(*images, data["object_pose"], **options)
        finer = egocentric_window(*doubled, data["object_pose"], **options)
        if upright:  # two neighbours that show one height may now be halves of one pixel
            assert ((finer - windows).abs() > 0.02).float().mean() < 0.002
        else:
            assert torch.equal(finer, windows)


def test_pixels_that_saw_nothing_count_as_table():
    depth, labels = image([(BAR, (0.66, 0.0, 0.0))])
    depth[:, ::3], depth[:, 1::3], depth[:, 2::3] = 0.0, math.nan, -1.0
    assert (egocentric_window(depth, labels, torch.tensor([MIDDLE])) == 0).all()


@pytest.mark.parametrize(
    ("change", "error", "message"),
    [
        (
            {"depth": torch.zeros(1, 9, 9).double()},
            TypeError,
            "depth must be a torch.float32 tensor",
        ),
        ({"depth": torch.zeros(9, 9)}, ValueError, r"depth must be \[B, H, W\], got \[9, 9\]"),
        ({"pose": torch.tensor([[0.0, math.nan, 0]])}, ValueError, "pose of scene 0 is not finite"),
        ({"depth": torch.full((1, 9, 9), 1100.0)}, ValueError, "depth must be in metres"),
        ({"max_height": 2.0}, ValueError, "between 0 and the camera's height 1.1 m, got 2.0"),
    ],
)
def test_bad_input_is_refused(change, error, message):
    given = {
        "depth": torch.ones(1, 9, 9),
        "segmentation": torch.zeros(1, 9, 9, dtype=torch.uint8),
        "pose": torch.zeros(1, 3),
    }
    with pytest.raises(error, match=message):
        egocentric_window(**{**given, **change})
