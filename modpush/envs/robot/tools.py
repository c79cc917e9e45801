"""The tools that the library brings. Source: sizes of the closed gripper as measured on the 2F-85."""

from modpush.envs.robot.robot import Tool
from modpush.geometry.shapes import box

_GREY, _DARK = (0.72, 0.74, 0.76), (0.25, 0.26, 0.28)

TOOLS: dict[str, Tool] = {
    # Closed by construction: one rigid link. The linkage juts out beyond the fingers along x.
    "2f85": Tool(
        name="2f85",
        mass=0.9,
        length=0.163,
        tip_half_extents=(0.032, 0.011),
        shapes=(
            box(0.084, 0.076, 0.090, (0.0, 0.0, 0.045), color=_DARK),
            box(0.124, 0.027, 0.071, (0.0, 0.0, 0.0825), color=_DARK),
            box(0.064, 0.022, 0.057, (0.0, 0.0, 0.1345), color=_GREY),
        ),
        half_turn=True,
    ),
    "rod": Tool(
        name="rod",
        mass=0.2,
        length=0.16,
        tip_half_extents=(0.01, 0.01),
        shapes=(box(0.02, 0.02, 0.16, (0.0, 0.0, 0.08), color=_DARK),),
        half_turn=True,
    ),
}
"""The tools by name. The paper names the gripper; the authors' released code pushes with the rod."""
