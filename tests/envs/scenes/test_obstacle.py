import json
import math

import numpy as np
import pytest

from modpush.envs import Obstacle, Patrol, Scenario
from modpush.envs.robot.named import ROBOTS, TOOLS
from modpush.envs.scenes.arm_room import obstacle_near_arm
from tests.envs.engines.sapien.test_agent import scenario

UR5, GRIPPER = ROBOTS["ur5"], TOOLS["2f85"]
BAR = (0.20, 0.06, 0.06)
PATROL = Patrol(velocity=(-0.06, 0.08), ahead=0.10, behind=0.05)
MOVING = Obstacle(BAR, (0.5, 0.0, 0.3), PATROL)


def test_a_patrol_is_what_small_steps_with_reversals_lead_to() -> None:
    step, speed = 1e-3, 0.1
    along, sign, expected = 0.0, 1.0, []
    for _ in range(10_000):  # 10 s: more than three lengths of the line
        expected.append((along, sign))
        along += sign * speed * step
        if not -0.05 < along < 0.10:
            along, sign = float(np.clip(along, -0.05, 0.10)), -sign
    expected = np.array(expected)
    direction = np.array([-0.6, 0.8])
    found = MOVING.at(step * np.arange(10_000))
    assert found.shape == (10_000, 4)
    away = found[:, :2] - [0.5, 0.0]
    np.testing.assert_allclose(away, expected[:, :1] * direction, atol=2.1e-4)  # two small steps
    velocity = expected[:, 1:] * speed * direction
    assert (np.abs(found[:, 2:] - velocity).max(1) < 1e-9).mean() > 0.995
    np.testing.assert_allclose(MOVING.ends(), [[0.53, -0.04], [0.44, 0.08]], atol=1e-12)


def test_an_obstacle_at_a_time_stands() -> None:
    assert MOVING.standing(0.0) == Obstacle(BAR, (0.5, 0.0, 0.3))
    x, y, yaw = MOVING.standing(0.5).pose
    assert (x, y, yaw) == pytest.approx((0.47, 0.04, 0.3))
    still = Obstacle(BAR, (0.5, 0.0, 0.3))
    assert still.standing(3.0) is still
    assert still.at(3.0).tolist() == [0.5, 0.0, 0.0, 0.0]


def test_an_obstacle_continues_from_any_time_as_it_would_have() -> None:
    times = np.linspace(
        0.0137, 7.0, 29
    )  # at no reversal, where the velocity is that of either side
    for start in (0.0, 0.4, 1.7, 3.3, 4.1):
        np.testing.assert_allclose(
            MOVING.after(start).at(times), MOVING.at(start + times), atol=1e-9
        )


def test_a_motion_is_plain_data_and_absent_where_there_is_none() -> None:
    start = scenario((0.5, 0.0, 0.0), obstacles=(Obstacle(BAR, (0.5, 0.2, 0.0)), MOVING))
    plain = json.loads(json.dumps(start.to_dict()))
    assert Scenario.from_dict(plain) == start
    assert plain["obstacles"][0] == {"size": list(BAR), "pose": [0.5, 0.2, 0.0]}
    moved = {"velocity": [-0.06, 0.08], "ahead": 0.10, "behind": 0.05}
    assert plain["obstacles"][1]["motion"] == moved


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"velocity": (math.nan, 0.0)}, "velocity.* finite"),
        ({"velocity": (0.0, 0.0)}, "velocity must be at least 0.001 m/s"),
        ({"velocity": (0.0, 2.0)}, "velocity"),
        ({"velocity": (0.1,)}, "velocity"),
        ({"ahead": -0.1}, "ahead"),
        ({"ahead": 0.0, "behind": 0.0}, "ahead and behind must be at least 0.01 m together"),
    ],
)
def test_a_wrong_patrol_is_refused(changes, message) -> None:
    with pytest.raises(ValueError, match=f"Patrol: .*{message}"):
        Patrol(**{"velocity": (0.0, 0.1), "ahead": 0.1, "behind": 0.1, **changes})


def test_a_patrol_out_of_the_workspace_is_refused() -> None:
    long = Patrol(velocity=(0.0, 0.1), ahead=0.40, behind=0.1)
    assert Obstacle(BAR, (0.5, 0.0, 0.0), long).ends()[1].tolist() == [0.5, 0.40]
    with pytest.raises(ValueError, match=r"motion must keep the centre within .* \[0.5, 0.5\]"):
        Obstacle(BAR, (0.5, 0.1, 0.0), long)
    with pytest.raises(ValueError, match="motion"):
        Obstacle(BAR, (0.5, 0.1, 0.0), "fast")


def test_a_patrol_into_the_arm_is_found() -> None:
    far = Obstacle(BAR, (0.4, 0.0, 0.0))
    assert obstacle_near_arm([far], UR5, GRIPPER) is None
    towards = Patrol(velocity=(-0.1, 0.0), ahead=0.2, behind=0.0)
    assert "robot's axis" in obstacle_near_arm(
        [Obstacle(far.size, far.pose, towards)], UR5, GRIPPER
    )
    # Not at its ends, but between them.
    aside = Obstacle((0.06, 0.06, 0.06), (0.16, -0.3, 0.0))
    past = Patrol(velocity=(0.0, 0.1), ahead=0.6, behind=0.0)
    assert obstacle_near_arm([aside, Obstacle(aside.size, (0.16, 0.3, 0.0))], UR5, GRIPPER) is None
    assert obstacle_near_arm([Obstacle(aside.size, aside.pose, past)], UR5, GRIPPER) is not None
