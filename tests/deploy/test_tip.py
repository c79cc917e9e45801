import math

import numpy as np
import pytest

from modpush.deploy.push_motion import touches
from modpush.envs import OBJECTS, TOOLS, PushedObject
from modpush.geometry import box


def test_the_tip_is_where_the_engine_has_it(rig) -> None:
    for _ in range(5):
        rig.controller.reset((0.6, 0.1))
        state = rig.arm.observe()
        rig.arm.command(rig.controller.act(rig.read_depth().depth, state.joints))
    ours = rig.arm.robot.tip_transform(rig.arm.observe().joints, rig.arm.tool)
    theirs = rig.arm.scene.link_transforms(["tip"])[0]
    assert ours[:3, 3] == pytest.approx(theirs[:3], abs=1e-5)
    assert ours[2, 2] == pytest.approx(-1.0, abs=1e-4)


def rod_at(x: float, y: float) -> np.ndarray:
    """A flange that holds the rod's tip near the table, pointing down."""
    flange = np.diag([1.0, -1.0, -1.0, 1.0])
    flange[:3, 3] = x, y, 0.02 + TOOLS["rod"].length
    return flange


def test_contact_begins_where_the_surfaces_meet() -> None:
    # The rod is 2 cm wide and the cube 5 cm: centres 3.5 cm apart touch.
    rod, cube = TOOLS["rod"], OBJECTS["small_cube"]
    assert touches(rod, rod_at(0.4, 0.0), cube, (0.4 + 0.0349, 0.0, 0.0), 0.0)
    assert not touches(rod, rod_at(0.4, 0.0), cube, (0.4 + 0.0351, 0.0, 0.0), 0.0)
    assert touches(rod, rod_at(0.4, 0.0), cube, (0.4 + 0.0389, 0.0, 0.0), 0.004)
    # Turned by 45 degrees the cube's corner is nearer.
    assert touches(rod, rod_at(0.4, 0.0), cube, (0.4 + 0.045, 0.0, math.pi / 4), 0.0)


def test_between_two_legs_is_no_contact() -> None:
    legs = (box(0.02, 0.1, 0.05, (0.04, 0.0, 0.0)), box(0.02, 0.1, 0.05, (-0.04, 0.0, 0.0)))
    item = PushedObject(name="two_bars", parts=legs)
    assert not touches(TOOLS["rod"], rod_at(0.0, 0.0), item, (0.0, 0.0, 0.0), 0.004)
