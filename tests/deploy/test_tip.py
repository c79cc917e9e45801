import math

import numpy as np
import pytest

from modpush.deploy.tip import tip_transform, touches
from modpush.envs import OBJECTS, TOOLS, PushedObject
from modpush.geometry import box


def test_the_tip_is_where_the_engine_has_it(rig) -> None:
    for _ in range(5):
        rig.controller.reset((0.6, 0.1))
        state = rig.arm.observe()
        rig.arm.command(rig.controller.act(rig.read_depth().depth, state.joints))
    ours = tip_transform(rig.arm.robot, rig.arm.tool, rig.arm.observe().joints)
    theirs = rig.arm.scene.link_transforms(["tip"])[0]
    assert ours[:3, 3] == pytest.approx(theirs[:3], abs=1e-5)
    assert ours[2, 2] == pytest.approx(-1.0, abs=1e-4)


def tip_at(x: float, y: float) -> np.ndarray:
    """A tip on the table, pointing down."""
    tip = np.diag([1.0, -1.0, -1.0, 1.0])
    tip[:3, 3] = x, y, 0.02
    return tip


def test_contact_begins_where_the_surfaces_meet() -> None:
    # The rod is 2 cm wide and the cube 5 cm: centres 3.5 cm apart touch.
    rod, cube = TOOLS["rod"], OBJECTS["small_cube"]
    assert touches(rod, tip_at(0.4, 0.0), cube, (0.4 + 0.0349, 0.0, 0.0), 0.0)
    assert not touches(rod, tip_at(0.4, 0.0), cube, (0.4 + 0.0351, 0.0, 0.0), 0.0)
    assert touches(rod, tip_at(0.4, 0.0), cube, (0.4 + 0.0389, 0.0, 0.0), 0.004)
    # Turned by 45 degrees the cube's corner is nearer.
    assert touches(rod, tip_at(0.4, 0.0), cube, (0.4 + 0.045, 0.0, math.pi / 4), 0.0)


def test_between_two_legs_is_no_contact() -> None:
    legs = (box(0.02, 0.1, 0.05, (0.04, 0.0, 0.0)), box(0.02, 0.1, 0.05, (-0.04, 0.0, 0.0)))
    item = PushedObject(name="two_bars", parts=legs)
    assert not touches(TOOLS["rod"], tip_at(0.0, 0.0), item, (0.0, 0.0, 0.0), 0.004)
