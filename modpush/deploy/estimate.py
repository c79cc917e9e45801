"""Results of perception: the object's estimated pose, and the policy's images."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray


class ObjectEstimate(NamedTuple):
    """The pushed object's pose, as one depth image shows it."""

    pose: tuple[float, float, float]
    """x, y, yaw in the base frame [m, m, rad]. Yaw continues from image to image; at the first one it is
    one of those at which the object looks the same."""
    residual: float
    """Share of the visible pixels on and beside the object that contradict its pose, in [0, 1]."""
    hidden: float
    """Share of the object's top that the image does not show, in [0, 1]."""
    found: bool
    """The image confirms the pose. If not, the pose is predicted from the tool's motion."""
    unseen_for: int
    """Number of images since the last one that confirmed a pose; 0 if this one does."""


class Perceived(NamedTuple):
    """Input of a policy's stack, from one depth image."""

    depth: NDArray[np.float32]
    """Image of the policy's camera, straight down, without the arm, `[H, W]` [m]."""
    segmentation: NDArray[np.uint8]
    """`[H, W]`, values of `modpush.geometry.Label`: table, object and obstacle."""
    object: ObjectEstimate
    """The pushed object."""
    tip_pose: tuple[float, float, float]
    """x, y, yaw of the tool's tip by the joint angles [m, m, rad]."""
    seen: NDArray[np.bool_]
    """`[H, W]`, the pixels' places on the table that this image or an earlier one has shown."""
