"""Where paths lead with an obstacle that moves."""

import numpy as np
import pytest
import torch
from tensordict import TensorDict

from modpush import PushEnvConfig, make_push_env
from modpush.geometry.camera import CAMERA
from modpush.geometry.workspace import Rectangle
from modpush.planners import SweptObstacles, inflate


def cells_of(*rectangles):
    """`[256, 256]` bool: cells within rectangles (x, y, half lengths)."""
    centres = np.stack(np.meshgrid(np.arange(256), np.arange(256)), -1).astype(np.float64)
    places = CAMERA.unproject(centres)
    cells = np.zeros((256, 256), bool)
    for x, y, a, b in rectangles:
        cells |= (np.abs(places - (x, y)) <= (a, b)).all(-1)
    return cells


def swept(cells, motion, radius=0.03, seconds=2.0, patrol_area=None):
    occupancy = inflate(torch.from_numpy(cells)[None], radius / CAMERA.cell_size)
    td = TensorDict(
        {
            "occupancy": occupancy[:, None],
            "blocked_bits": torch.from_numpy(np.packbits(cells, axis=1, bitorder="little"))[None],
            "obstacle_motion": torch.tensor([motion]),
            "object_radius": torch.tensor([[radius]]),
        },
        [1],
    )
    after = SweptObstacles(seconds, patrol_area=patrol_area)(td.clone())["occupancy"][0, 0].numpy()
    return occupancy[0].numpy(), after


@pytest.mark.parametrize("velocity", [(0.0, 0.1), (0.0, -0.1), (0.06, 0.08)])
def test_the_way_of_the_next_seconds_is_blocked(velocity) -> None:
    vx, vy = velocity
    _, after = swept(cells_of((0.45, 0.0, 0.05, 0.03)), [0.45, 0.0, vx, vy])
    steps = np.linspace(0.0, 2.0, 200)
    rectangles = [(0.45 + vx * t, vy * t, 0.05, 0.03) for t in steps]
    expected = inflate(torch.from_numpy(cells_of(*rectangles))[None], 0.03 / CAMERA.cell_size)
    differ = after != expected[0].numpy()
    assert differ.sum() < 0.02 * after.sum()  # rounded to cells at the way's sides


def test_the_way_back_is_blocked_where_the_obstacle_turns_round() -> None:
    """It is 5 cm from the area's edge, and 10 cm behind where it is after 2 s."""
    cells = cells_of((0.45, 0.3, 0.05, 0.03))
    area = Rectangle((0.2, -0.35), (0.75, 0.35))
    _, after = swept(cells, [0.45, 0.3, 0.0, 0.1], patrol_area=area)
    expected = cells_of((0.45, 0.275, 0.05, 0.03 + 0.075))  # from y = 0.20 to 0.35
    expected = inflate(torch.from_numpy(expected)[None], 0.03 / CAMERA.cell_size)[0].numpy()
    assert (after != expected).sum() < 0.02 * after.sum()


def test_only_the_obstacle_that_moves_is_swept() -> None:
    moving, standing = (0.45, 0.0, 0.05, 0.03), (0.45, -0.25, 0.05, 0.03)
    before, after = swept(cells_of(moving, standing), [0.45, 0.0, 0.0, 0.1])
    _, alone = swept(cells_of(moving), [0.45, 0.0, 0.0, 0.1])
    assert np.array_equal(after, before | alone)


def test_nothing_changes_where_nothing_moves_or_nothing_is_seen() -> None:
    cells = cells_of((0.45, 0.0, 0.05, 0.03))
    for motion in ([0.0] * 4, [0.7, 0.3, 0.0, 0.1]):
        before, after = swept(cells, motion)
        assert np.array_equal(before, after)


def test_a_path_leads_behind_a_bar_that_moves() -> None:
    options = {"goal": "pose", "pushed_object": "box", "scene": "moving_bar", "encoder": "none"}
    options |= {"num_envs": 2, "obstacle_motion": True, "obstacle_between": True, "distance": 0.5}
    lengths = []
    for ahead in (0.0, 2.0):
        env = make_push_env(motion_ahead=ahead, seed=0, **options)
        lengths.append(env.reset()["path_length"])
        env.close()
    assert (lengths[1] >= lengths[0] - 1e-4).all()
    assert (lengths[1] > lengths[0] + 0.01).any()


def test_it_needs_to_know_how_obstacles_move() -> None:
    with pytest.raises(ValueError, match="motion_ahead needs obstacle_motion"):
        PushEnvConfig(motion_ahead=1.0)
    with pytest.raises(ValueError, match="seconds"):
        SweptObstacles(0.0)
