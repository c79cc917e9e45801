"""`stereo_noise`: from an exact depth image to one as a stereo depth camera gives it."""

import cv2
import numpy as np
from numpy.typing import NDArray

from modpush._types import Fraction, NonNegative, NonNegativeLength, Positive
from modpush._validation import checked_arguments

_EDGE = 0.02  # step of depth from pixel to pixel that is an edge, per depth
_PATCH = 5  # side of the patches that a matcher compares [px]


@checked_arguments
def stereo_noise(
    depth: NDArray[np.float32],
    rng: np.random.Generator,
    focal_length: Positive = 520.0,
    *,
    axial: NonNegativeLength = 0.0015,
    jitter: NonNegative = 0.7,
    baseline: NonNegativeLength = 0.05,
    edge_holes: Fraction = 0.3,
    flying: Fraction = 0.15,
    grazing_holes: Fraction = 0.8,
    speckle: Fraction = 0.002,
) -> NDArray[np.float32]:
    """Noise and holes as a stereo depth camera such as Intel's RealSense has them.

    Axial noise grows with the square of depth, half of its variance common to neighbouring pixels. Edges
    are ragged; some of their pixels have no reading, and some fly between foreground and background.
    Surfaces seen at a grazing angle have holes, and so has the background beside a foreground, where only
    one of the two imagers sees it.

    Args:
        depth: `[H, W]` along the optical axis [m]; 0 has no reading and stays so.
        rng: Random numbers.
        focal_length: Of the camera [px].
        axial: Standard deviation at 1 m [m].
        jitter: Standard deviation of the place that a pixel reads [px].
        baseline: Distance of the two imagers [m]; 0 makes no shadows.
        edge_holes, flying: Shares of the pixels at edges without a reading, and that fly.
        grazing_holes: Share of those without one where a surface is inclined by more than 80 degrees.
        speckle: Share of all other pixels without a reading.

    Returns:
        `[H, W]` float32 [m].
    """
    height, width = depth.shape
    v, u = np.indices(depth.shape, dtype=np.float32)
    shift = rng.standard_normal((2, height, width), dtype=np.float32) * np.float32(jitter)
    column = np.clip(np.rint(u + shift[0]), 0, width - 1).astype(np.intp)
    row = np.clip(np.rint(v + shift[1]), 0, height - 1).astype(np.intp)
    ragged = depth[row, column]

    low, high = (
        operation(depth, np.ones((3, 3), np.uint8)) for operation in (cv2.erode, cv2.dilate)
    )
    # On an inclined surface both sides are equally far away.
    at_edge = np.abs(high + low - 2 * depth) > _EDGE * depth
    white, common = rng.standard_normal((2, height, width), dtype=np.float32)
    common = cv2.GaussianBlur(common, (0, 0), _PATCH / 4)
    noise = np.float32(np.sqrt(0.5)) * (white + common / common.std())
    found = ragged + np.float32(axial) * ragged**2 * noise

    chance = rng.random(depth.shape, dtype=np.float32)
    flies = at_edge & (chance < flying)
    found = np.where(flies, low + rng.random(depth.shape, dtype=np.float32) * (high - low), found)
    hole = at_edge & (chance > 1 - edge_holes)
    slope = np.hypot(
        cv2.Sobel(depth, -1, 1, 0, scale=1 / 8), cv2.Sobel(depth, -1, 0, 1, scale=1 / 8)
    )
    steep = slope * np.float32(focal_length) > np.tan(np.radians(80.0)) * depth
    hole |= (steep & ~at_edge & (rng.random(depth.shape, dtype=np.float32) < grazing_holes)) | (
        rng.random(depth.shape, dtype=np.float32) < speckle
    )
    if baseline > 0:
        hole |= _shadow(depth, focal_length * baseline)
    return np.where(hole | (ragged <= 0), 0.0, found).astype(np.float32)


def _shadow(depth: NDArray[np.float32], scale: float) -> NDArray[np.bool_]:
    """Pixels that the second imager does not see, since something to their right is before them."""
    seen_at = np.arange(depth.shape[1]) - scale / np.maximum(depth, 1e-3)
    nearest = np.minimum.accumulate(seen_at[:, ::-1], axis=1)[:, ::-1]
    hidden = np.zeros(depth.shape, dtype=bool)
    hidden[:, :-1] = nearest[:, 1:] <= seen_at[:, :-1]
    return hidden
