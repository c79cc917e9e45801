import numpy as np
import pytest

from modpush.evaluation.metrics import (
    contact_rate,
    episode_metrics,
    mean_jerk,
    reversal_rate,
    success_weighted_by_path_length,
)


def flags(text: str) -> np.ndarray:
    return np.array([c == "1" for c in text])


@pytest.mark.parametrize(
    ("contact", "rate"),
    [
        ("0011011", 0.8),  # from the third step on: 4 of 5
        ("1000", 0.25),
        ("0001", 1.0),
        ("0000", 0.0),
        ("", 0.0),
    ],
)
def test_contact_counts_from_the_first_contact_on(contact: str, rate: float) -> None:
    assert contact_rate(flags(contact)) == pytest.approx(rate)


@pytest.mark.parametrize(
    ("success", "taken", "spl"), [(True, 0.5, 0.8), (True, 0.3, 1.0), (False, 0.4, 0.0)]
)
def test_spl(success: bool, taken: float, spl: float) -> None:
    assert success_weighted_by_path_length(success, 0.4, taken) == pytest.approx(spl)


def test_jerk_is_the_third_difference_over_the_time_step_cubed() -> None:
    # x = t^3: its third difference is 3! = 6 at steps of 1 s, and its jerk is 6 at any time step.
    cubic = np.stack([np.arange(6.0) ** 3, np.zeros(6)], -1)
    assert mean_jerk(cubic, 1.0) == pytest.approx(6.0)
    assert mean_jerk(cubic, 2.0) == pytest.approx(48.0)  # 6 / 0.5^3
    # Constant speed, then a stop: 0 1 2 3 3 3 has differences 1 1 1 0 0, 0 0 -1 0, 0 -1 1.
    stop = np.array([[0.0, 0.0], [0.0, 1.0], [0.0, 2.0], [0.0, 3.0], [0.0, 3.0], [0.0, 3.0]])
    assert mean_jerk(stop, 1.0) == pytest.approx(2 / 3)
    assert mean_jerk(stop[:3], 1.0) == 0.0


def test_a_reversal_is_a_turn_by_more_than_a_right_angle_between_moves() -> None:
    # Ahead, left (90 degrees), back and left (45), ahead and right (180): 1 of 3 turns.
    moves = np.array([[0.02, 0.0], [0.0, 0.02], [-0.02, 0.02], [0.02, -0.02]])
    position = np.concatenate([np.zeros((1, 2)), np.cumsum(moves, 0)])
    assert reversal_rate(position) == pytest.approx(1 / 3)
    # Ahead, rest (0.5 mm), back: the rest is no move, so that one move follows another and is turned.
    assert reversal_rate(np.array([[0.0, 0.0], [0.02, 0.0], [0.0205, 0.0], [0.01, 0.0]])) == 1.0
    assert reversal_rate(position[:2]) == 0.0
    assert reversal_rate(np.zeros((9, 2))) == 0.0


def test_an_episode_by_hand() -> None:
    metrics = episode_metrics(
        object_position=np.array([[0.0, 0.0], [0.0, 0.0], [0.3, 0.0], [0.3, 0.4], [0.3, 0.4]]),
        goal_position=np.array([0.3, 0.45]),
        reward=np.array([-1.0, -0.5, -0.25, 5.0]),
        contacts=np.stack([flags("0101"), flags("0001"), flags("1000")], 1),
        contacts_at_end=np.stack([flags("0100"), flags("0001"), flags("0011")], 1),
        ee_position=np.array([[0.0, 0.0], [0.1, 0.0], [0.1, 0.1], [0.0, 0.1], [0.1, 0.1]]),
        control_freq=10.0,
        success=True,
        out_of_bounds=False,
        shortest_length=0.6,
    )
    assert metrics.steps == 4
    assert metrics.episode_return == pytest.approx(3.25)
    assert metrics.contact_rate == pytest.approx(2 / 3)
    assert metrics.contact_rate_at_end == pytest.approx(1 / 3)
    assert metrics.collision_rate == pytest.approx(0.5)
    assert metrics.collision_rate_object == pytest.approx(0.25)
    assert metrics.collision_rate_arm == pytest.approx(0.25)
    assert metrics.collision_rate_at_end == pytest.approx(0.5)
    assert metrics.collision_rate_object_at_end == pytest.approx(0.25)
    # Moves (0.1, 0), (0, 0.1), (-0.1, 0), (0.1, 0): the last of 3 turns is a reversal. Second differences
    # (-0.1, 0.1), (-0.1, -0.1), (0.2, 0); third (0, -0.2), (0.3, 0.1), over 0.1^3.
    assert metrics.reversal_rate == pytest.approx(1 / 3)
    assert metrics.mean_jerk == pytest.approx((200 + np.hypot(300, 100)) / 2)
    assert metrics.path_length == pytest.approx(0.75)  # 0.3 + 0.4 + 0.05
    assert metrics.final_distance == pytest.approx(0.05)
    assert metrics.spl == pytest.approx(0.8)
