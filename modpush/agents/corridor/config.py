"""Settings of the pushing-corridor controller."""

import math
from typing import Annotated, Literal

from annotated_types import Ge, Le
from pydantic import Strict

from modpush._types import (
    Angle,
    Count,
    Finite,
    NonNegative,
    NonNegativeInteger,
    Positive,
    PositiveFraction,
)
from modpush._validation import checked
from modpush.geometry.workspace import WORKSPACE, Rectangle


@checked
class CorridorConfig:
    """Settings of `PushingCorridorController`; `faithful_config` gives those of the authors.

    Raises:
        ValueError: If a number is out of its range, or `rules` is unknown.
    """

    rules: Literal["mended", "faithful"] = "mended"
    """`"mended"` corrects the mistakes in the authors' code, `"faithful"` keeps them."""
    prior_strength: NonNegative = 5.84
    """Parameter R0 of the prior on (mu, kappa): length of the sum of its pseudo-observations."""
    prior_count: NonNegative = 7.0
    """Parameter c of the prior: number of its pseudo-observations; with R0 the mode is kappa 3.37."""
    prior_direction: Angle = 0.0
    """Parameter phi of the prior: expected best pushing angle [rad]."""
    inversion: Finite = 0.4
    """Value of psi_relocate from which on the tool goes around the object instead of pushing it.

    At the prior's kappa of 3.37 the default is reached at a deviation of 13 degrees, the paper's 0.6
    only at 21 degrees. The authors' code ran at a kappa of 50, where 0.6 is reached at 5 degrees."""
    approach_gain: NonNegative = 1.0
    """Speed towards the object while the tool goes around it from afar; 1 is full speed."""
    retreat_gain: NonNegative = 0.1
    """Speed away from the object while the tool goes around it nearby, multiplied by psi_relocate."""
    near_distance: NonNegative = 0.035
    """Distance from the object's circumscribed circle at which the tool counts as near it [m]."""
    mean_gain: NonNegative = 0.05
    """Gain K_mu of the correction by the object's mean deviation."""
    last_gain: NonNegative = 0.1
    """Gain K_gamma of the correction by the object's last deviation."""
    learnable_deviation: Annotated[float, Ge(0)] = 0.15
    """Largest deviation of the object at which a push counts as successful [rad]."""
    moved_distance: NonNegative = 1e-4
    """Distance above which the object counts as moved in a step [m]."""
    inner_zone: NonNegative = 1.2
    """Width of the inner zone around obstacles, in circumscribed radii of the object."""
    outer_zone: NonNegative = 2.4
    """Width of the outer zone around obstacles, in circumscribed radii of the object."""
    touch_zone: NonNegative = 1.0
    """Distance from an obstacle at which the object touches it, in circumscribed radii of the
    object; the value of the controller's `touch_radius_key` is used where it is smaller."""
    zone_costs: Annotated[tuple[Positive, Positive, Positive], Strict(False)] = (
        1.0,
        50.0,
        200.0,
    )
    """Cost of a cell that is free, in the outer zone, and in the inner zone."""
    workspace: Rectangle | None = WORKSPACE
    """Rectangle in which the object should stay: lower and upper corner (x, y) [m]. Cells outside it
    cost as much as the inner zone. None for no limit."""
    neighbours: Literal[4, 8] = 8
    """Number of neighbours of a cell in the path search."""
    path_points: Annotated[Count, Ge(2), Le(100_000)] = 256
    """Number of points of the planned path."""
    behind_distance: NonNegative = 0.0816
    """Distance behind the object's centre at which the look-ahead expects the tool to push [m]."""
    tool_clearance: NonNegative = 0.03
    """Clearance of the tool's centre from obstacles on its path behind the object [m]."""
    path_step: Count = 20
    """Number of path points by which the target leads the object where the look-ahead finds no better
    one."""
    max_angles: Annotated[Count, Le(1_000_000)] = 200
    """Largest number of angles of successful pushes that are kept."""
    action_length: PositiveFraction = 1.0
    """Length of the action in the plane; 1 is the environment's limit along an axis."""
    contact_distance: NonNegative = 0.015
    """Distance of the pushing tool's centre from the object's circumscribed circle [m]. Where
    obstacles leave no room for the tool there, the target is turned; 0 turns no target."""
    navigate_distance: NonNegative = 0.08
    """Distance of the object from an obstacle below which the tool's path around the object is
    planned [m]; 0 plans none."""
    avoid_distance: NonNegative = 0.05
    """Distance from an obstacle below which a tool that goes around the object is repelled from it
    [m]; 0 for no repulsion."""
    patience: NonNegativeInteger = 5
    """Number of steps without motion after which the tool backs off; 0 for never."""
    escape_steps: NonNegativeInteger = 8
    """Number of steps for which the tool backs off."""
    max_turn: NonNegative = 0.05
    """Rotation of the tool by an action of 1, with which its wide side is turned towards the push
    [rad]; 0 turns no tool."""

    def __post_init__(self) -> None:
        """Check the relations between fields."""
        if not self.prior_count > self.prior_strength:
            raise ValueError(
                "CorridorConfig: prior_count must exceed prior_strength, got "
                f"{self.prior_count} and {self.prior_strength}."
            )


def faithful_config() -> CorridorConfig:
    """Settings of the authors: zones of 4.24 and 8.49 cm for an object of radius 3.54 cm.

    Their loop decides every 1.5 mm (240 times a second). Fifteen decisions a second at full speed are
    one every 2 cm, with which a controller that goes around the object from 5.4 degrees on oscillates
    about the position behind it. A quarter of the speed, 5 mm per decision, still crosses the table
    in 200 steps.
    """
    radius = 0.025 * math.sqrt(2.0)
    return CorridorConfig(
        rules="faithful",
        near_distance=0.07 - radius,
        inversion=0.6,
        learnable_deviation=math.inf,
        tool_clearance=0.0,
        path_step=5,
        contact_distance=0.0,
        navigate_distance=0.0,
        avoid_distance=0.0,
        patience=0,
        max_turn=0.0,
        inner_zone=0.03 * math.sqrt(2.0) / radius,
        outer_zone=0.06 * math.sqrt(2.0) / radius,
        touch_zone=7 * 0.00354 / radius,
        workspace=None,
        neighbours=4,
        action_length=0.25,
    )
