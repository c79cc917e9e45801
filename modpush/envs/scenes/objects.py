"""The pushed objects, as data. Obstacles are part of a scene's layout, see `scenes`."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from modpush.geometry.shapes import Primitive, box, cylinder, prism
from modpush.parts import find_part

__all__ = ["OBJECTS", "PushedObject", "get_object", "get_object_of"]


@dataclass(frozen=True, kw_only=True)
class PushedObject:
    """A rigid body to push. Its frame sits in the middle of its height, over the footprint's centroid."""

    name: str
    parts: tuple[Primitive, ...]
    """Convex solids in the object's frame."""
    height: float
    """[m]"""
    radius: float
    """Of the footprint's circumscribed circle about the object's origin [m]."""
    symmetry: int
    """How many yaw angles look alike: 4 for a square footprint; 0 for a disc (all of them)."""
    mass: float = 1.0
    """[kg]; the same for all, as in the paper."""

    @property
    def tool_height(self) -> float:
        """Height of the tool's tip over the table that suits the object [m] (spec 3).

        2 cm, or half the height of a flat one, but never under 1.2 cm.
        """
        return max(0.012, min(0.02, self.height / 2))

    def footprints(self, num_arc: int = 32) -> list[np.ndarray]:
        """Outlines of the parts seen from above, object frame, a list of `[n, 2]` [m]."""
        outlines = []
        for part in self.parts:
            if part.kind == "prism":
                outlines.append(np.array(part.outline))
            elif part.kind == "cylinder":
                angle = np.linspace(0.0, 2 * np.pi, num_arc, endpoint=False)
                outlines.append(part.size[0] * np.stack([np.cos(angle), np.sin(angle)], -1))
            else:
                hx, hy = part.size[:2]
                outlines.append(np.array([[hx, hy], [-hx, hy], [-hx, -hy], [hx, -hy]]))
        return outlines


def _fragment() -> PushedObject:
    """A flat shard, about 8.2 x 8.5 x 2.9 cm, with one notch: two convex parts of our own drawing."""
    lower = [(-4.1, -2.2), (-1.0, -4.2), (2.6, -3.6), (4.1, -0.4), (1.6, 0.9)]
    upper = [(1.6, 0.9), (2.9, 3.4), (-0.4, 4.3), (-3.2, 2.6), (-4.1, -2.2)]
    parts = [np.array(part) / 100 for part in (lower, upper)]
    areas, centroids = zip(*(_area_and_centroid(part) for part in parts), strict=True)
    center = np.average(centroids, axis=0, weights=areas)
    outlines = [part - center for part in parts]
    prisms = tuple(
        prism(tuple((float(x), float(y)) for x, y in outline), 0.029, color=(0.62, 0.45, 0.33))
        for outline in outlines
    )
    radius = max(float(np.linalg.norm(outline, axis=1).max()) for outline in outlines)
    return PushedObject(name="fragment", parts=prisms, height=0.029, radius=radius, symmetry=1)


def _area_and_centroid(outline: np.ndarray) -> tuple[float, np.ndarray]:
    """Shoelace formulas for a counter-clockwise outline `[n, 2]`."""
    following = np.roll(outline, -1, axis=0)
    cross = outline[:, 0] * following[:, 1] - following[:, 0] * outline[:, 1]
    area = cross.sum() / 2
    return float(area), ((outline + following) * cross[:, None]).sum(0) / (6 * area)


OBJECTS: dict[str, PushedObject] = {
    item.name: item
    for item in (
        PushedObject(
            name="small_cube",
            parts=(box(0.05, 0.05, 0.05, color=(0.80, 0.12, 0.10)),),
            height=0.05,
            radius=math.hypot(0.025, 0.025),
            symmetry=4,
        ),
        PushedObject(
            name="large_cube",
            parts=(box(0.08, 0.05, 0.05, color=(0.10, 0.60, 0.20)),),
            height=0.05,
            radius=math.hypot(0.04, 0.025),
            symmetry=2,
        ),
        PushedObject(
            name="small_cylinder",
            parts=(cylinder(0.03, 0.06, color=(0.10, 0.25, 0.80)),),
            height=0.06,
            radius=0.03,
            symmetry=0,
        ),
        _fragment(),
    )
}
"""By name. Source: paper Sec. V (objects), spec 2 (sizes, mass)."""


def get_object(name: str | PushedObject) -> PushedObject:
    """Look a pushed object up by name or by `"module:name"`, or pass one of your own through.

    An object that is found by `"module:name"` is called so: that text is its `name`, by which
    evaluation and drawing find it again.

    Raises:
        ValueError: If there is no such object, with those there are; or if it is no `PushedObject`.
    """
    found = find_part("pushed_object", name, OBJECTS)
    if not isinstance(found, PushedObject):
        raise ValueError(f"pushed_object: {name!r} must be a PushedObject, got {found!r}.")
    if isinstance(name, str) and name not in OBJECTS:
        return replace(found, name=name)
    return found


def get_object_of(items: Sequence[PushedObject], name: str) -> PushedObject:
    """The object of this name among those a task was built with."""
    for item in items:
        if item.name == name:
            return item
    get_object(name)  # says so if there is no such object at all
    raise ValueError(
        f"pushed_object: {name!r} was not loaded, this environment has "
        f"{[item.name for item in items]}."
    )
