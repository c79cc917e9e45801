"""Numbers of the pushing-corridor controller."""

import math
from dataclasses import dataclass

Corner = tuple[float, float]


@dataclass(frozen=True, kw_only=True)
class CorridorConfig:
    """Numbers of `PushingCorridorController`; `faithful_config` gives the authors' own."""

    prior_strength: float = 5.84
    """R0 of the prior on (mu, kappa)."""
    prior_count: float = 7.0
    """c of the prior; with R0 its mode is kappa = 3.37."""
    prior_direction: float = 0.0
    """phi of the prior [rad]."""
    inversion: float = 0.4
    """psi_relocate from which on the tool goes round the object instead of pushing it.

    At the prior's kappa of 3.37 it is reached 13 degrees off, the paper's 0.6 only 21 degrees off;
    the authors' own code ran at a kappa of 50, where 0.6 is reached 5 degrees off. What either
    does to success and contact is in `docs/evaluation.md`."""
    approach_gain: float = 1.0
    """Speed towards the object while going round it from afar."""
    retreat_gain: float = 0.1
    """Speed away from it, times psi_relocate, while going round it nearby."""
    near: float = 0.035
    """Nearby begins so far from the object's circumscribed circle [m]."""
    mean_gain: float = 0.05
    """K_mu: share of the mean deviation that is steered against."""
    last_gain: float = 0.1
    """K_gamma: share of the last deviation that is steered against."""
    success: float = 0.15
    """A push that deviated by more is none to learn from, though the one before was worse [rad]."""
    moved: float = 1e-4
    """A step in which the object moved by more counts [m]."""
    inner_zone: float = 1.2
    """Width of the inner zone in circumscribed radii of the object."""
    outer_zone: float = 2.4
    """Width of the outer zone in the same."""
    touch_zone: float = 1.0
    """Room that the object needs, in the same."""
    weights: tuple[float, float, float] = (1.0, 50.0, 200.0)
    """Cost of a free cell, of the outer zone, of the inner zone."""
    workspace: tuple[tuple[float, float], tuple[float, float]] | None = (
        (0.20, -0.35),
        (0.75, 0.35),
    )
    """Lower and upper corner (x, y) of where the object should stay: beyond, cells cost as in the
    inner zone; None: no such place [m]."""
    neighbours: int = 8
    """Of a cell, for A*."""
    path_points: int = 256
    """Points that the path is held by."""
    behind: float = 0.0816
    """How far behind the object the place to push it from is looked for [m]."""
    tool_room: float = 0.03
    """Room that the tool needs to either side on its way behind the object [m]."""
    path_step: int = 20
    """Points of the path that the target is ahead where none is seen that suits."""
    window: int = 200
    """How many successful angles are remembered, and at most."""
    step: float = 1.0
    """Length of an action, 1 is the most the environment allows in an axis."""
    contact: float = 0.015
    """Without room for the tool so far behind the object the target is turned; 0: not [m]."""
    navigate: float = 0.08
    """Where the object is nearer to an obstacle, the tool's way round it is planned; 0: not [m]."""
    avoid: float = 0.05
    """While it goes round the object the tool is pushed off nearer obstacles; 0: not [m]."""
    patience: int = 5
    """After so many steps in which nothing moved the tool backs off; 0: never."""
    escape: int = 8
    """For so many steps."""
    max_turn: float = 0.05
    """What an action of 1 turns the tool by, whose wide side follows the way; 0: never turn [rad]."""
    faithful: bool = False
    """Keep the authors' mistakes: posterior, angle wrapping, means, condition to invert."""

    def __post_init__(self) -> None:
        if not self.prior_count > self.prior_strength >= 0:
            raise ValueError(
                "CorridorConfig: prior_count must exceed prior_strength >= 0, got "
                f"{self.prior_count} and {self.prior_strength}."
            )
        if not 0 < self.step <= 1:
            raise ValueError(f"CorridorConfig: step must lie in (0, 1], got {self.step}.")
        if self.path_points < 2 or self.window < 1:
            raise ValueError(
                "CorridorConfig: path_points must be >= 2 and window >= 1, got "
                f"{self.path_points} and {self.window}."
            )


def faithful_config() -> CorridorConfig:
    """The authors' numbers: zones of 4.24 and 8.49 cm for an object of radius 3.54 cm.

    Their loop decides anew every 1.5 mm (240 times a second). Fifteen times a second at full speed
    is every 2 cm, and a controller that goes round the object from 5.4 degrees on then steps over
    the place behind it and back without end. A quarter of the speed, 5 mm, is the nearest that
    still crosses the table in 200 steps.
    """
    radius = 0.025 * math.sqrt(2.0)
    return CorridorConfig(
        near=0.07 - radius,
        inversion=0.6,
        success=math.inf,
        tool_room=0.0,
        path_step=5,
        contact=0.0,
        navigate=0.0,
        avoid=0.0,
        patience=0,
        max_turn=0.0,
        inner_zone=0.03 * math.sqrt(2.0) / radius,
        outer_zone=0.06 * math.sqrt(2.0) / radius,
        touch_zone=7 * 0.00354 / radius,
        workspace=None,
        neighbours=4,
        step=0.25,
        faithful=True,
    )
