"""Settings of the pushing-corridor controller."""

import math
from typing import Annotated, Literal

from annotated_types import Ge, Le
from pydantic import Strict

from modpush._types import (
    ORDERED,
    Angle,
    Count,
    Finite,
    NonNegative,
    NonNegativeInteger,
    Positive,
    PositiveFraction,
    Real,
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
    """Whether the mistakes in the authors' code are corrected (`mended`) or kept (`faithful`)."""
    prior_strength: NonNegative = 5.84
    """Parameter R0 of the prior on (mu, kappa): length of the sum of the unit vectors that it stands
    for."""
    prior_count: NonNegative = 7.0
    """Parameter c of the prior: number of angles that it stands for; with R0 the mode is kappa 3.37."""
    prior_direction: Angle = 0.0
    """Parameter phi of the prior: the angle that it expects to be best [rad]."""
    inversion: Finite = 0.4
    """Value of psi_relocate from which on the tool goes round the object instead of pushing it.

    At the prior's kappa of 3.37 the default is reached at a deviation of 13 degrees, the paper's 0.6
    only at 21 degrees; the authors' code ran at a kappa of 50, where 0.6 is reached at 5 degrees.
    `docs/results/baseline/README.md` compares success and contact on the tuning sets."""
    approach_gain: NonNegative = 1.0
    """Speed towards the object while the tool goes round it from afar, 1 is full speed."""
    retreat_gain: NonNegative = 0.1
    """Speed away from the object while the tool goes round it nearby; it is multiplied by
    psi_relocate."""
    near_distance: NonNegative = 0.035
    """Distance from the object's circumscribed circle at which the tool counts as near it [m]."""
    mean_gain: NonNegative = 0.05
    """Gain K_mu: share of the object's mean deviation that the controller steers against."""
    last_gain: NonNegative = 0.1
    """Gain K_gamma: share of the object's last deviation that the controller steers against."""
    learnable_deviation: Annotated[Real, Ge(0)] = 0.15
    """Largest deviation of the object in a push that the controller learns from [rad]."""
    moved_distance: NonNegative = 1e-4
    """Least distance by which the object must move in a step for the step to count [m]."""
    inner_zone: NonNegative = 1.2
    """Width of the inner zone around obstacles, in circumscribed radii of the object."""
    outer_zone: NonNegative = 2.4
    """Width of the outer zone around obstacles, in circumscribed radii of the object."""
    touch_zone: NonNegative = 1.0
    """Distance from an obstacle at which the object touches it, in circumscribed radii of the
    object; less if the controller's `touch_radius_key` gives a smaller one."""
    zone_costs: Annotated[tuple[Positive, Positive, Positive], Strict(False), ORDERED] = (
        1.0,
        50.0,
        200.0,
    )
    """Cost of a free cell, of one in the outer zone, and of one in the inner zone."""
    workspace: Rectangle | None = WORKSPACE
    """Lower and upper corner (x, y) of the rectangle in which the object should stay; cells outside
    of it cost as much as the inner zone. None for no such rectangle [m]."""
    neighbours: Literal[4, 8] = 8
    """Number of neighbours of a cell in the search for the path."""
    path_points: Annotated[Count, Ge(2), Le(100_000)] = 256
    """Number of points of the planned path."""
    behind_distance: NonNegative = 0.0816
    """Distance behind the object's centre at which the look-ahead expects the tool to push [m]."""
    tool_clearance: NonNegative = 0.03
    """Distance that the tool's centre keeps from obstacles on its way behind the object [m]."""
    path_step: Count = 20
    """Number of points of the path by which the target is ahead of the object if the look-ahead
    finds no better one."""
    max_angles: Annotated[Count, Le(1_000_000)] = 200
    """Largest number of angles of successful pushes that are remembered."""
    action_length: PositiveFraction = 1.0
    """Length of the action in the plane; 1 is the largest that the environment allows in an axis."""
    contact_distance: NonNegative = 0.015
    """Distance of the pushing tool's centre from the object's circumscribed circle: where obstacles
    leave no room for it there, the target is turned; 0 to never turn it [m]."""
    navigate_distance: NonNegative = 0.08
    """Distance of the object from an obstacle below which the tool's path around the object is
    planned; 0 to never plan it [m]."""
    avoid_distance: NonNegative = 0.05
    """Distance from an obstacle below which a tool that goes round the object is pushed away from
    it; 0 to never do so [m]."""
    patience: NonNegativeInteger = 5
    """Number of steps in which nothing moves after which the tool backs off; 0 to never do so."""
    escape_steps: NonNegativeInteger = 8
    """Number of steps for which the tool backs off."""
    max_turn: NonNegative = 0.05
    """Angle by which an action of 1 turns the tool, whose wide side is turned towards the push; 0
    to never turn it [rad]."""

    def __post_init__(self) -> None:
        """Check what depends on several fields."""
        if not self.prior_count > self.prior_strength:
            raise ValueError(
                "CorridorConfig: prior_count must exceed prior_strength, got "
                f"{self.prior_count} and {self.prior_strength}."
            )


def faithful_config() -> CorridorConfig:
    """Settings of the authors: zones of 4.24 and 8.49 cm for an object of radius 3.54 cm.

    Their loop decides anew every 1.5 mm (240 times a second). Fifteen times a second at full speed
    is every 2 cm; a controller that goes around the object from 5.4 degrees on then steps over the
    place behind it and back without end. A quarter of the speed, 5 mm, is the nearest that still
    crosses the table in 200 steps.
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
