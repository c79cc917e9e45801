"""The pushed objects, as plain data."""

import functools
import re
from collections.abc import Mapping, Sequence
from dataclasses import field, replace
from typing import Annotated, Literal

import numpy as np
from annotated_types import Ge, Le

from modpush._types import AtLeastOne, Name, Positive
from modpush._validation import checked
from modpush.geometry.footprint import (
    area_and_centroid,
    centroid,
    circumscribed_radius,
    inscribed_radius,
    outline_of,
    support,
    vertical_range,
    yaw_symmetry,
)
from modpush.geometry.shapes import Primitive, box, cylinder, prism
from modpush.parts import find_part

Circle = Literal["circumscribed", "inscribed"]
"""A circle about an object's origin: around its footprint, or inside it."""

SUPPORT_DIRECTIONS = 48
"""Number of directions in which an object's extent is given."""

_TOLERANCE = 1e-4  # of where an object's frame must be [m]


@checked
class PushedObject:
    """A rigid body to push, made of convex, upright parts.

    Its frame sits in the middle of its height, over the centroid of its parts; `centered` moves parts
    there. It rests on the table on its lowest parts. Height, radii and symmetry are computed from the
    parts.

    Raises:
        ValueError: If there are no parts, one of them is tilted, the frame sits elsewhere, the mass is
            not positive, or the parts do not have the symmetry that is given.
    """

    name: Name
    """Name of the object, different from those of the others in an environment."""
    parts: AtLeastOne[Primitive]
    """Upright solids in the object's frame, see `modpush.geometry`."""
    mass: Annotated[Positive, Ge(1e-3), Le(1e3)] = 1.0
    """Mass [kg]."""
    symmetry: Annotated[int, Ge(-1), Le(360)] = -1
    """Number of yaw angles at which the object looks the same: 4 for a square footprint, 0 for a disc
    (all of them). -1 computes it from the parts; a smaller number may be given if the parts differ in
    a way that is not visible."""
    tip_height: Annotated[Positive, Le(1)] | None = None
    """Height of the tool's tip over the table while this object is pushed [m]; None takes 2 cm, or half
    the height of a flat object, but never under 1.2 cm."""
    height: float = field(init=False)
    """Height, computed [m]."""
    radius: float = field(init=False)
    """Radius of the circle about the object's origin that holds its footprint, computed [m]."""
    inscribed_radius: float = field(init=False)
    """Radius of the largest circle about the object's origin that its footprint holds, computed [m]."""

    def __post_init__(self) -> None:
        for part in self.parts:
            if part.rpy[:2] != (0.0, 0.0):
                raise ValueError(f"{self.name!r}: parts must stand upright, got rpy {part.rpy}.")
        low, high = zip(*map(vertical_range, self.parts), strict=True)
        object.__setattr__(self, "height", max(high) - min(low))
        object.__setattr__(self, "radius", circumscribed_radius(self.parts))
        object.__setattr__(self, "inscribed_radius", inscribed_radius(self.parts))
        offset = (*centroid(self.parts), (max(high) + min(low)) / 2)
        if max(map(abs, offset)) > _TOLERANCE:
            raise ValueError(
                f"{self.name!r}: the frame must sit in the middle of the parts' height over their "
                f"centroid, which are at {tuple(round(x, 4) for x in offset)} m; give centered(*parts)."
            )
        self._check_symmetry()

    def radius_of(self, circle: Circle) -> float:
        """Radius of the circumscribed or the inscribed circle of the footprint [m]."""
        return self.radius if circle == "circumscribed" else self.inscribed_radius

    def _check_symmetry(self) -> None:
        found = yaw_symmetry(self.parts)
        if self.symmetry == -1:
            object.__setattr__(self, "symmetry", found)
        elif self.symmetry != found and (
            self.symmetry < 1 or (found > 0 and found % self.symmetry != 0)
        ):
            raise ValueError(
                f"{self.name!r}: symmetry {self.symmetry} contradicts the parts, which look alike "
                f"at {found} yaw angles (0: at all of them); give a divisor of it, or -1 to compute it."
            )

    @functools.cached_property
    def support(self) -> np.ndarray:
        """Extent of the footprint from the origin in `SUPPORT_DIRECTIONS` directions, `[n]` [m].

        The first direction is the object's x, the others follow counter-clockwise at equal angles.
        """
        return support(self.parts, SUPPORT_DIRECTIONS)

    @property
    def sides(self) -> tuple[float, float]:
        """Lengths of the rectangle about the origin that reaches the nearer end along each axis [m]."""
        ahead, left, back, right = support(self.parts, 4).tolist()
        return 2 * min(ahead, back), 2 * min(left, right)

    @property
    def tool_height(self) -> float:
        """Height of the tool's tip over the table while this object is pushed [m], see `tip_height`."""
        if self.tip_height is not None:
            return self.tip_height
        return max(0.012, min(0.02, self.height / 2))

    def footprints(self, num_arc: int = 32) -> list[np.ndarray]:
        """Outlines of the parts seen from above, object frame, a list of `[n, 2]` [m]."""
        return [outline_of(part, num_arc) for part in self.parts]


def _fragment() -> PushedObject:
    """A flat shard, about 8.2 x 8.5 x 2.9 cm, with one notch: two convex parts of our own drawing."""
    lower = [(-4.1, -2.2), (-1.0, -4.2), (2.6, -3.6), (4.1, -0.4), (1.6, 0.9)]
    upper = [(1.6, 0.9), (2.9, 3.4), (-0.4, 4.3), (-3.2, 2.6), (-4.1, -2.2)]
    parts = [np.array(part) / 100 for part in (lower, upper)]
    areas, centroids = zip(*(area_and_centroid(part) for part in parts), strict=True)
    center = np.average(centroids, axis=0, weights=areas)
    outlines = [part - center for part in parts]
    prisms = tuple(
        prism(tuple((float(x), float(y)) for x, y in outline), 0.029, color=(0.62, 0.45, 0.33))
        for outline in outlines
    )
    return PushedObject(name="fragment", parts=prisms)


OBJECTS: dict[str, PushedObject] = {
    item.name: item
    for item in (
        PushedObject(
            name="small_cube",
            parts=(box(0.05, 0.05, 0.05, color=(0.80, 0.12, 0.10)),),
        ),
        PushedObject(
            name="large_cube",
            parts=(box(0.08, 0.05, 0.05, color=(0.10, 0.60, 0.20)),),
        ),
        PushedObject(
            name="small_cylinder",
            parts=(cylinder(0.03, 0.06, color=(0.10, 0.25, 0.80)),),
        ),
        _fragment(),
        PushedObject(
            name="box",
            parts=(box(0.10, 0.05, 0.05, color=(0.85, 0.55, 0.10)),),
        ),
    )
}
"""The shipped objects by name."""

PAPER_OBJECTS = ("small_cube", "large_cube", "small_cylinder", "fragment")
"""Those of the paper. Source: Sec. V; sizes and mass as in the authors' code."""


_RANDOM = re.compile(r"random_(0|[1-9]\d{0,8})")


@functools.lru_cache(maxsize=1024)
def random_object(seed: int) -> PushedObject:
    """A box, an upright cylinder or a prism over a convex outline, of 4 to 10 cm, drawn from a seed.

    Its name is `random_<seed>`, by which `get_object` makes it again.

    Args:
        seed: Determines shape and size.
    """
    rng, name = np.random.default_rng([seed, 20_221_023]), f"random_{seed}"
    height = float(rng.uniform(0.03, 0.07))
    kind = rng.integers(3)
    if kind == 0:
        length, width = rng.uniform(0.04, 0.09), rng.uniform(0.04, 0.065)
        return PushedObject(name=name, parts=(box(float(length), float(width), height),))
    if kind == 1:
        return PushedObject(name=name, parts=(cylinder(float(rng.uniform(0.02, 0.045)), height),))
    # Corners on an ellipse, at least 15 degrees apart, make a convex outline.
    count = int(rng.integers(3, 8))
    gaps = rng.dirichlet(np.full(count, 4.0)) * (2 * np.pi - count * np.pi / 12) + np.pi / 12
    angles = np.cumsum(gaps) + rng.uniform(0, 2 * np.pi)
    corners = np.stack([np.cos(angles), np.sin(angles)], -1) * rng.uniform(0.028, 0.05, 2)
    center = area_and_centroid(corners)[1]
    outline = tuple((float(x), float(y)) for x, y in corners - center)
    return PushedObject(name=name, parts=(prism(outline, height),))


def random_object_seed(name: str) -> int | None:
    """The seed in the name of a `random_object`; None for any other name."""
    match = _RANDOM.fullmatch(name)
    return int(match[1]) if match else None


def get_object(
    name: str | PushedObject, objects: Mapping[str, PushedObject] | None = None
) -> PushedObject:
    """Look a pushed object up by name or by `"module:name"`, or pass one of your own through.

    `"random_7"` is `random_object(7)`. An object that is found by `"module:name"` is called so: that text
    is its `name`, by which evaluation and drawing find it again. Those of `objects`, as in
    `PushEnv.pushed_objects`, come before the shipped ones.

    Raises:
        ValueError: If there is no such object (the known ones are listed), or it is not a `PushedObject`.
    """
    known = OBJECTS if objects is None else {**OBJECTS, **objects}
    if isinstance(name, str) and name in known:
        return known[name]
    seed = random_object_seed(name) if isinstance(name, str) else None
    if seed is not None:
        return random_object(seed)
    found = find_part("pushed_object", name, known)
    if not isinstance(found, PushedObject):
        raise ValueError(f"pushed_object: {name!r} must be a PushedObject, got {found!r}.")
    return replace(found, name=name) if isinstance(name, str) else found


def get_object_of(items: Sequence[PushedObject], name: str) -> PushedObject:
    """The object of this name among those a task was built with."""
    for item in items:
        if item.name == name:
            return item
    raise ValueError(
        f"pushed_object: {name!r} was not loaded, expected one of this environment's "
        f"{[item.name for item in items]}."
    )
