"""Types of the fields of configurations and plain data: numbers, names and tuples with their ranges.

They are checked by `modpush._validation`; a type checker sees float, int, str and tuple.
"""

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TypeAlias, TypeVar

import numpy as np
from pydantic import AfterValidator, BeforeValidator, Field, Strict, StringConstraints
from pydantic_core import PydanticCustomError

T = TypeVar("T")


def _one_number(value: Any) -> Any:
    """A number as a range from it to itself."""
    is_number = isinstance(value, int | float | np.number) and not isinstance(value, bool)
    return (value, value) if is_number else value


ONE_NUMBER = BeforeValidator(_one_number)
"""For ranges: a single number may be given, too."""


def _ascending(span: tuple[T, T]) -> tuple[T, T]:
    if span[0] > span[1]:  # type: ignore[operator]  # of numbers
        raise PydanticCustomError("span", "Input should be a range (lowest, highest)")
    return span


SPAN = AfterValidator(_ascending)
"""For ranges: the lower end comes first."""
Finite = Annotated[float, Field(allow_inf_nan=False)]
"""A finite number."""
Positive = Annotated[float, Field(allow_inf_nan=False, gt=0)]
"""A finite number > 0."""
NonNegative = Annotated[float, Field(allow_inf_nan=False, ge=0)]
"""A finite number >= 0."""
Fraction = Annotated[float, Field(allow_inf_nan=False, ge=0, le=1)]
"""A number in [0, 1]."""
PositiveFraction = Annotated[float, Field(allow_inf_nan=False, gt=0, le=1)]
"""A number in (0, 1]."""
HalfTurn = Annotated[float, Field(allow_inf_nan=False, gt=0, lt=math.pi)]
"""An angle in (0, pi) [rad]."""
YawTolerance = Annotated[float, Field(allow_inf_nan=False, gt=0, le=math.pi)]
"""An angle in (0, pi] [rad]."""
Coordinate = Annotated[float, Field(allow_inf_nan=False, ge=-100, le=100)]
"""A coordinate on the table [m]; nothing is farther than 100 m."""
Length = Annotated[float, Field(allow_inf_nan=False, gt=0, le=100)]
"""A positive length [m], up to 100 m."""
NonNegativeLength = Annotated[float, Field(allow_inf_nan=False, ge=0, le=100)]
"""A length [m], up to 100 m."""
Angle = Annotated[float, Field(allow_inf_nan=False, ge=-1000, le=1000)]
"""An angle [rad]; it need not be wrapped."""

NonNegativeInteger = Annotated[int, Field(ge=0, lt=2**62)]
"""A whole number >= 0."""
Count = Annotated[int, Field(ge=1, lt=2**62)]
"""A whole number >= 1."""
Frequency = Annotated[int, Field(ge=1, le=100_000)]
"""Steps per second [Hz]."""
PixelCount = Annotated[int, Field(ge=1, le=16_384)]
"""A side of an image [px]."""
Seed = Annotated[int, Field(ge=0, lt=2**63)]
"""A seed of random numbers."""
Scenes = Annotated[int, Field(ge=1, le=65_536)]
"""A number of scenes that are stepped together."""

Name = Annotated[str, StringConstraints(min_length=1)]
"""Text that is not empty."""
PartName = Annotated[str, StringConstraints(pattern=r"^[\w.]+:[\w.]+$")]
"""Place of a user's own part, "module:name"."""
Device = Annotated[str, StringConstraints(pattern=r"^[a-z]+(:\d+)?$")]
"""A torch device, "cpu" or "cuda:0" for instance."""
FilePath = Annotated[Path, Strict(False)]
"""The path of a file or folder, as text or as a `Path`."""
Key = Name | Annotated[tuple[Name, ...], Field(min_length=1)]
"""A key of a tensordict, nested or not."""

# A list does for a tuple: it is what files and command lines give.
Point = Annotated[tuple[Coordinate, Coordinate], Strict(False)]
"""x and y [m]."""
Position = Annotated[tuple[Coordinate, Coordinate, Coordinate], Strict(False)]
"""x, y and z [m]."""
Pose = Annotated[tuple[Coordinate, Coordinate, Angle], Strict(False)]
"""x, y and yaw [m, m, rad]."""
Size = Annotated[tuple[Length, Length, Length], Strict(False)]
"""Length, width and height [m]."""
Extents = Annotated[tuple[NonNegativeLength, NonNegativeLength, NonNegativeLength], Strict(False)]
"""Sizes along x, y and z [m], of which some may be 0."""
Angles = Annotated[tuple[Angle, Angle, Angle], Strict(False)]
"""Roll, pitch and yaw [rad]."""
Color = Annotated[tuple[Fraction, Fraction, Fraction], Strict(False)]
"""Red, green and blue in [0, 1]."""
LengthSpan = Annotated[tuple[Length, Length], Strict(False), SPAN]
"""Lower and upper end of a range of lengths [m]."""
FractionSpan = Annotated[tuple[Fraction, Fraction], Strict(False), SPAN]
"""Lower and upper end of a range within [0, 1]."""
_Steps = Annotated[int, Field(ge=0, le=1000)]
if TYPE_CHECKING:  # type checkers know of no conversion
    StepSpan: TypeAlias = Any
else:
    StepSpan = Annotated[tuple[_Steps, _Steps], Strict(False), SPAN, ONE_NUMBER]
"""Lowest and highest of a number of steps, both included; or one number."""
Several = Annotated[tuple[T, ...], Strict(False)]
"""Any number of something."""
AtLeastOne = Annotated[tuple[T, ...], Strict(False), Field(min_length=1)]
"""One of something or more."""
