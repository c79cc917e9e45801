"""Checks of what annotations cannot express: shapes and dtypes of tensors, units, keys.

`name` is the name of the argument, for the error. Compiled kernels check nothing themselves.
"""

from collections.abc import Collection, Iterable, Mapping, Sequence
from typing import Any

import torch
from tensordict import NestedKey, TensorDictBase
from torch import Tensor

_NO_NUMBERS = {torch.bool, torch.complex32, torch.complex64, torch.complex128}

_TOLERANCE = 1.1  # of the camera's height over the table


def check_dtype(name: str, value: Any, dtype: torch.dtype) -> None:
    """Raise a TypeError unless a value is a torch tensor of a dtype."""
    if not isinstance(value, Tensor):
        raise TypeError(
            f"{name} must be a {dtype} tensor, got {type(value).__module__}.{type(value).__name__}."
        )
    if value.dtype != dtype:
        raise TypeError(f"{name} must be a {dtype} tensor, got {value.dtype}.")


def check_shape(name: str, value: Tensor, letters: str, expected: Sequence[int]) -> None:
    """Raise a ValueError unless a tensor has a shape; `letters` name its dimensions, `"B, H, W"`."""
    if value.shape != tuple(expected):
        raise ValueError(f"{name} must be [{letters}] = {list(expected)}, got {list(value.shape)}.")


def check_instance(name: str, value: Any, kind: type) -> None:
    """Raise a TypeError unless a value is of a class."""
    if not isinstance(value, kind):
        raise TypeError(f"{name} must be of type {kind.__name__}, got {type(value).__name__}.")


def check_real(name: str, value: Any, *last: int) -> None:
    """Check that a value is a tensor of real numbers `[..., *last]`, in less than a microsecond."""
    if not isinstance(value, Tensor):
        raise TypeError(f"{name} must be a tensor, got {type(value).__name__}.")
    if value.dtype in _NO_NUMBERS:
        raise TypeError(f"{name} must be a tensor of real numbers, got {value.dtype}.")
    if last and value.shape[-len(last) :] != last:
        dims = ", ".join(map(str, last))
        raise ValueError(f"{name} must be [..., {dims}], got {list(value.shape)}.")


def check_finite(name: str, value: Tensor) -> None:
    """Raise a ValueError with the first row that is not finite, if there is one; it waits for a GPU."""
    good = value.isfinite()
    if not good.all():
        index = (~good).nonzero()[0, : max(value.ndim - 1, 0)].tolist()
        raise ValueError(
            f"{name} must be finite, got {value[tuple(index)].tolist()} in row {index}."
        )


def check_keys(state: Mapping[str, Any], expected: Collection[str]) -> None:
    """Raise a ValueError unless a state holds the expected fields, and nothing else."""
    if not isinstance(state, Mapping) or set(state) != set(expected):
        got = sorted(map(str, state)) if isinstance(state, Mapping) else repr(state)
        raise ValueError(f"the state must hold {sorted(expected)}, got {got}.")


def check_depth_unit(depth: Tensor, camera_z: float) -> None:
    """Refuse depth in another unit than metres, which would read as an empty table.

    Args:
        depth: `[B, H, W]` [m]; 0 where nothing was seen.
        camera_z: Height of the camera over the table [m].
    """
    limit = _TOLERANCE * camera_z
    # NaN and infinity count as beyond. The pixel in the middle settles nearly all images.
    height, width = depth.shape[1:]
    if (depth[:, height // 2, width // 2].abs() <= limit).all():
        return
    good = (depth.abs() <= limit).flatten(1).any(1)
    if not good.all():
        scene = int((~good).nonzero()[0, 0])
        raise ValueError(
            f"depth must be in metres along the optical axis of a camera {camera_z:g} m over "
            f"the table, got {depth[scene].min().item():g} to {depth[scene].max().item():g} in scene "
            f"{scene}: not one pixel shows the table or what stands on it."
        )


def read_key(tensordict: TensorDictBase, key: NestedKey, *last: int) -> Tensor:
    """The entry under a key; the error for a missing one lists the keys that there are."""
    value = tensordict.get(key, None)
    if value is None:
        raise KeyError(
            f"key {key!r} is missing; there are {sorted(map(str, tensordict.keys(True, True)))}."
        )
    if last and value.shape[-len(last) :] != last:
        raise ValueError(
            f"{key!r} must be [..., {', '.join(map(str, last))}], got {list(value.shape)}."
        )
    return value


def check_spec_has(spec: "TensorDictBase", keys: Iterable[NestedKey]) -> None:
    """Raise a KeyError unless an environment emits what a transform reads."""
    missing = [key for key in keys if spec.get(key, None) is None]
    if missing:
        raise KeyError(
            f"the environment does not emit {missing}; it emits "
            f"{sorted(map(str, spec.keys(True, True)))}."
        )


def stored_next(
    tensordict: TensorDictBase,
    in_keys: Iterable[NestedKey],
    out_keys: Iterable[NestedKey],
) -> TensorDictBase | None:
    """The `"next"` of stored transitions, which a transform has to rewrite along with the root.

    Returns:
        None if there is no `"next"`, or if it has neither all that is read nor any of what is
        written: then nothing in it can be out of date.

    Raises:
        KeyError: If it has some of what is written, but not all that is read.
    """
    after = tensordict.get("next", None)
    if after is None:
        return None
    missing = [key for key in in_keys if after.get(key, None) is None]
    if not missing:
        return after
    stale = [key for key in out_keys if after.get(key, None) is not None]
    if stale:
        raise KeyError(
            f"{missing} are missing in 'next', so that {stale} there cannot be written "
            f"anew; there are {sorted(map(str, after.keys(True, True)))}."
        )
    return None
