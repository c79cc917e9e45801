"""Physical constants of the task, the same for every engine."""

STIFFNESS = 2e4
"""Stiffness of the joint drives [N m/rad]."""
DAMPING = 5e2
"""Damping of the joint drives [N m s/rad]. With velocity targets it causes no lag."""
FRICTION: dict[str, float] = {"object": 0.5, "table": 0.5, "obstacle": 0.5, "tool": 0.0}
"""Friction coefficient of each material. A pair has the mean of two, so that it is 0.5 between object
and table, 0.25 between tool and object, and 0.5 between object and obstacle."""
CONTACT_GAP = 0.001
"""Bodies whose surfaces are nearer than this count as touching [m]."""
