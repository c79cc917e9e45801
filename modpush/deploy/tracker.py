"""`ObjectTracker`: the pushed object's pose from depth images, followed from one to the next."""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from modpush.deploy.finding import ObjectFinder
from modpush.deploy.height_map import ARM, HeightMap
from modpush.deploy.outlines import padded, place, points_within
from modpush.deploy.push_motion import PushMotion
from modpush.deploy.registration import (
    BEHIND,
    Expectation,
    ObjectShape,
    best_pose,
    compare,
    gather,
)
from modpush.envs.scenes.objects import PushedObject
from modpush.geometry.camera_model import CameraModel

_PIXELS = 350
"""About the number of pixels on the object that are compared."""
_MOST_PIXELS = 6000
_AROUND = 0.04
"""Distance from the object up to which pixels are compared [m]."""
_TOUCH = 0.004
"""Distance of tool and object up to which it may have been pushed [m]."""
_PUSHED, _RESTING = (0.006, 0.10), (0.0015, 0.025)
"""Standard deviation of the predicted pose [m, rad]."""
_UNSURE, _ANYWHERE = (0.03, 2.0), (1.0, 10.0)
_CONFIRMED = 0.25
"""Residual up to which an image confirms a pose."""
_LEAST_SHOWN = 0.12
"""Least share of the object's pixels that must show something to confirm a pose."""
_DOUBT = 0.10
"""Residual from which other poses near by are tried."""
_SEARCHES = 30
"""Number of those from which is searched: with 8, one in 20 was stuck at a wrong yaw."""
_BETTER = 0.01
"""Difference of the scores for which a pose further away is believed."""
_PATIENCE = 3
"""Number of images in a row that contradict the pose before the object is looked for."""
_CANDIDATES = 12
_NEAR_GUESS = 0.06
"""Distance from a guess within which the object is looked for [m]."""

Floats = NDArray[np.float64]


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


class ObjectTracker:
    """Registers the known shape of an object in depth images.

    Each image is compared with what it would show of the object: pixels on it that show something behind
    it contradict a pose, and so do pixels beside it that show something that is neither table nor a known
    obstacle. What the arm hides says nothing; there, the pose is predicted from the tool's motion.

    Args:
        item: The object.
        camera: The camera.
        heights: The map of the table, in which the object is looked for.
    """

    def __init__(self, item: PushedObject, camera: CameraModel, heights: HeightMap) -> None:
        self.item, self.camera, self.heights = item, camera, heights
        self._motion = PushMotion(item)
        self._finder = ObjectFinder(item, heights.view.cell_size)
        self._shape = ObjectShape.of(item)
        self._origin = np.array(camera.position)
        self._top = points_within(item, 21)
        self._pixels = np.empty((_MOST_PIXELS, 5))
        self.reset()

    def reset(self, guess: Sequence[float] | None = None) -> None:
        """Forget the object; the next image begins an episode.

        Args:
            guess: Place (x, y) or pose (x, y, yaw) near which the object is [m, m, rad]; None looks
                everywhere.

        Raises:
            ValueError: If the guess has another length, or is not finite.
        """
        self._guess = _checked_guess(guess)
        self._pose: Floats | None = None
        self._contradicted = self._unseen = 0

    def update(
        self,
        depth: NDArray[np.float32],
        kind: NDArray[np.uint8],
        before: list[Floats],
        after: list[Floats],
    ) -> ObjectEstimate | None:
        """Take in an image.

        Args:
            depth: `[H, W]` [m].
            kind: `[H, W]`, what each pixel is, from `sort_pixels`; `heights.look` has read both.
            before: Outlines of the tool when the image before was taken, from `tool_outlines`.
            after: The same for this image.

        Returns:
            The estimate; None if the object has not been found since the last reset.
        """
        self._depth, self._kind = depth, kind
        self._known = self.heights.around()
        self._tool = padded(after)
        if self._pose is None:
            found = self._find(self._guess)
            if found is None:
                return None
            self._pose = found
            return self._judge(found)[0]
        predicted, gap = self._motion.predict(self._pose, before, after)
        spread = _PUSHED if gap < _TOUCH else _RESTING
        near = _near(predicted, self._pose)
        estimate, score = self._judge(self._refine(predicted, spread, near))
        if self._unseen or estimate.residual > _DOUBT:
            wide = _wide(predicted, self.item.symmetry)
            again, other = self._judge(self._refine(predicted, _UNSURE, wide, _SEARCHES))
            if again.found and other < score - _BETTER:
                estimate = again
        self._contradicted = 0 if estimate.residual <= _CONFIRMED else self._contradicted + 1
        if self._contradicted >= _PATIENCE:
            found = self._find(self._pose)
            if found is None:
                found = self._find(None)
            if found is not None:
                (estimate, _), self._contradicted = self._judge(found), 0
        self._unseen = 0 if estimate.found else self._unseen + 1
        yaw = _nearest_yaw(estimate.pose[2], self._pose[2], self.item.symmetry)
        self._pose = np.array([*estimate.pose[:2], yaw])
        return estimate._replace(pose=(*estimate.pose[:2], yaw), unseen_for=self._unseen)

    def _find(self, guess: Floats | None) -> Floats | None:
        """The best pose in the whole image, or near a guess; None if nothing looks like the object."""
        best, least = None, math.inf
        for number, candidate in enumerate(self._finder.candidates(self.heights, _CANDIDATES)):
            if guess is not None and not np.linalg.norm((candidate - guess)[:2]) < _NEAR_GUESS:
                continue
            found = self._refine(candidate, _ANYWHERE, _near(candidate, candidate))
            estimate, score = self._judge(found)
            score += 0.02 * number
            if estimate.found and score < least:
                best, least = found, score
        if best is not None and guess is not None:
            best[2] = _nearest_yaw(best[2], guess[2], self.item.symmetry)
        return best

    def _refine(
        self, prior: Floats, spread: tuple[float, float], starts: Floats, keep: int = 2
    ) -> Floats:
        """The pose near some poses that explains the image best; searched from `keep` of them."""
        pixels, weight = self._gather(prior)
        place_spread, yaw_spread = spread
        spreads = np.array([place_spread, place_spread, yaw_spread])
        expected = Expectation(prior, spreads, weight, *self._tool)
        found: Floats = best_pose(starts, expected, pixels, self._origin, self._shape, keep)
        return found

    def _gather(self, pose: Floats) -> tuple[Floats, float]:
        """The pixels around a pose, and how many of them the object would cover."""
        reach, height = self.item.radius + _AROUND, self.item.height
        x, y, _ = pose
        corners = [
            (x + a * reach, y + b * reach, z)
            for a in (-1, 1)
            for b in (-1, 1)
            for z in (0.0, height)
        ]
        at, _ = self.camera.project(np.array(corners))
        width, rows = self.camera.size
        if not np.isfinite(at).all():
            return self._pixels[:0], 1.0
        low = np.clip(np.floor(at.min(0)), 0, (width, rows)).astype(int)
        high = np.clip(np.ceil(at.max(0)) + 1, 0, (width, rows)).astype(int)
        # The object's side in pixels, from its area seen from above.
        away = float(np.linalg.norm(np.array(self.camera.position) - (x, y, height / 2)))
        side = self.camera.intrinsics[0][0] / away * 1.8 * self.item.inscribed_radius
        area = (high - low).prod()
        stride = max(1, round(side / math.sqrt(_PIXELS)), math.ceil(math.sqrt(area / _MOST_PIXELS)))
        count = gather(
            self._depth,
            self._kind,
            self.camera.rays,
            self._origin,
            (*low.tolist(), *high.tolist()),
            stride,
            self._known,
            self.heights.corner,
            self.heights.view.cell_size,
            self._pixels,
        )
        return self._pixels[:count], max(1.0, (side / stride) ** 2)

    def _judge(self, pose: Floats) -> tuple[ObjectEstimate, float]:
        """The estimate of a pose, and its contradiction by pixels on the object and beside it."""
        pixels, weight = self._gather(pose)
        total, own, shown = compare(pose, pixels, self._origin, self._shape)
        residual = own / shown if shown else 0.0
        seen = shown >= _LEAST_SHOWN * weight
        x, y, yaw = pose.tolist()
        estimate = ObjectEstimate(
            pose=(x, y, yaw),
            residual=float(residual),
            hidden=self._hidden(pose),
            found=bool(seen and residual <= _CONFIRMED),
            unseen_for=0,
        )
        # A place of the object's size on a long obstacle fits as well, but the rest is beside it.
        return estimate, residual + 0.2 * (total - own) / weight

    def pixels_on_top(self, pose: Floats) -> tuple[NDArray[np.int64], NDArray[np.int64], Floats]:
        """Columns, rows and depths [m] at which the camera sees points on the object's top, `[n]` each.

        Args:
            pose: x, y, yaw of the object [m, m, rad].
        """
        points = np.full((len(self._top), 3), self.item.height)
        x, y, yaw = pose
        place(self._top, x, y, yaw, points[:, :2])
        at, depth = self.camera.project(points)
        width, height = self.camera.size
        column, row = np.rint(np.nan_to_num(at, nan=-1.0)).astype(int).T
        inside = (column >= 0) & (column < width) & (row >= 0) & (row < height)
        return column[inside], row[inside], depth[inside]

    def _hidden(self, pose: Floats) -> float:
        """Share of the top that is hidden at a pose."""
        column, row, depth = self.pixels_on_top(pose)
        before = self._depth[row, column] < depth - BEHIND
        hides = (self._kind[row, column] == ARM) | (before & (self._depth[row, column] > 0))
        return 1.0 - float((~hides).sum()) / len(self._top)


def _checked_guess(guess: Sequence[float] | None) -> Floats | None:
    if guess is None:
        return None
    values = np.array([*guess, 0.0] if len(guess) == 2 else guess, dtype=np.float64)
    if values.shape != (3,) or not np.isfinite(values).all():
        raise ValueError(f"ObjectTracker: guess must be 2 or 3 finite numbers, got {guess!r}.")
    return values


def _near(predicted: Floats, last: Floats) -> Floats:
    """Poses that are tried first."""
    steps = np.diag([6e-3, 6e-3, 0.15])
    moved = predicted + np.stack([steps, -steps], 1).reshape(-1, 3)
    return np.concatenate([predicted[None], moved, last[None]])


def _wide(middle: Floats, symmetry: int) -> Floats:
    """Poses around one, at all yaw angles that look different."""
    turns = 1 if symmetry == 0 else max(3, 24 // symmetry)
    yaws = np.arange(turns) * (2 * math.pi / (turns * max(1, symmetry)))
    grid = np.array([-0.02, -0.01, 0.0, 0.01, 0.02])
    x, y, yaw = np.meshgrid(grid, grid, yaws, indexing="ij")
    return middle + np.stack([x, y, yaw], -1).reshape(-1, 3)


def _nearest_yaw(yaw: float, last: float, symmetry: int) -> float:
    """Of the yaw angles at which an object looks the same, that nearest to the last one [rad]."""
    if symmetry == 0:
        return last
    turn = 2 * math.pi / symmetry
    return last + (yaw - last + turn / 2) % turn - turn / 2
