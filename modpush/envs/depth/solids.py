"""`Solids`: primitives as the arrays that the ray caster reads."""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from modpush.geometry.footprint import side_planes
from modpush.geometry.shapes import KINDS, Primitive

__all__ = ["Solids"]

_MAX_SIDES = 16  # of a prism


@dataclass(frozen=True)
class Solids:
    """Primitives of one body, or of many that stand still, as arrays that the kernels read."""

    kind: NDArray[np.int64]
    """`[n]`, index into `KINDS`."""
    size: NDArray[np.float64]
    """`[n, 3]`, as in `Primitive` [m]."""
    planes: NDArray[np.float64]
    """`[n, 16, 3]`, sides of a prism: outward normal (x, y) and distance; unused rows never cut."""
    rotation: NDArray[np.float64]
    """`[n, 3, 3]`, primitive to body."""
    position: NDArray[np.float64]
    """`[n, 3]`, in the body [m]."""

    @classmethod
    def of(cls, parts: Iterable[Primitive]) -> "Solids":
        """Collect primitives.

        Raises:
            ValueError: If a prism has more than 16 sides.
        """
        parts = tuple(parts)
        planes = np.zeros((len(parts), _MAX_SIDES, 3))
        planes[..., 2] = 1.0
        for i, part in enumerate(parts):
            sides = _side_planes(part)
            if len(sides) > _MAX_SIDES:
                raise ValueError(f"Solids: a prism may have {_MAX_SIDES} sides, got {len(sides)}.")
            planes[i, : len(sides)] = sides
        return cls(
            np.array([KINDS.index(part.kind) for part in parts], dtype=np.int64),
            np.array([part.size for part in parts], dtype=np.float64).reshape(-1, 3),
            planes,
            np.array([part.rotation() for part in parts]).reshape(-1, 3, 3),
            np.array([part.position for part in parts], dtype=np.float64).reshape(-1, 3),
        )

    def __len__(self) -> int:
        return len(self.kind)


def _side_planes(part: Primitive) -> NDArray[np.float64]:
    """Outward normals and distances of a prism's sides, `[m, 3]`."""
    if part.kind != "prism":
        return np.zeros((0, 3))
    return np.column_stack(side_planes(np.array(part.outline)))
