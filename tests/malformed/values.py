"""Wrong values in place of a right one, drawn at random."""

import math
import pickle
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor

Drawn = tuple[str, Any]
"""A label and a wrong value."""


class Anything:
    """An object that nothing can use."""

    def __repr__(self) -> str:
        return "<Anything>"


NEVER: list[Drawn] = [
    ("an object", Anything()),
    ("a complex number", 1j),
    ("an ellipsis", ...),
    ("bytes", b"3"),
]
"""Wrong for every argument."""


def wrong_value(value: Any, rng: np.random.Generator, optional: bool) -> Drawn:
    """A wrong value in place of a right one.

    Args:
        value: A right value.
        rng: Source of randomness.
        optional: Whether None would be right, too.
    """
    for kind, draw in _BY_TYPE.items():
        if isinstance(value, kind):
            drawn = draw(value, rng) if rng.random() < 0.85 else _pick(rng, NEVER)
            break
    else:
        drawn = _pick(rng, [*NEVER, ("text", "no such"), ("a number", 3), ("a list", [1, 2])])
    if drawn[1] is None and optional:
        return _pick(rng, NEVER)
    return drawn


def _pick(rng: np.random.Generator, choices: list[Any]) -> Any:
    return choices[rng.integers(len(choices))]


def _wrong_bool(value: bool, rng: np.random.Generator) -> Drawn:
    wrong = ("yes", 2, None, math.nan, (), [True])
    return _pick(rng, [(f"{x!r} for a bool", x) for x in wrong])


def _wrong_int(value: int, rng: np.random.Generator) -> Drawn:
    wrong = ("3", 1.5, None, math.nan, math.inf, [value], (), -(10**30), {}, np.float32(2.5))
    return _pick(rng, [(f"{x!r} for a whole number", x) for x in wrong])


def _wrong_float(value: float, rng: np.random.Generator) -> Drawn:
    wrong = ("3", None, math.nan, [value], (), {}, np.array([1.0, 2.0]), torch.ones(3))
    return _pick(rng, [(f"{type(x).__name__} {x!r} for a number", x) for x in wrong])


def _wrong_text(value: str, rng: np.random.Generator) -> Drawn:
    wrong = (3, None, (1, 2), math.nan, True, {})
    return _pick(rng, [(f"{x!r} for text", x) for x in wrong])


def _wrong_path(value: Path, rng: np.random.Generator) -> Drawn:
    wrong = (3, None, math.nan, True, (), {})
    return _pick(rng, [(f"{x!r} for a path", x) for x in wrong])


def _wrong_tuple(value: tuple[Any, ...], rng: np.random.Generator) -> Drawn:
    wrong: list[Drawn] = [("a number for a tuple", 3), ("a mapping for a tuple", {"a": 1})]
    if len(value):
        i = int(rng.integers(len(value)))
        label, item = wrong_value(value[i], rng, False)
        changed = (*value[:i], item, *value[i + 1 :])
        wrong += [(f"item {i}: {label}", changed)] * 4
    return _pick(rng, wrong)


def _wrong_mapping(value: Mapping[Any, Any], rng: np.random.Generator) -> Drawn:
    wrong: list[Drawn] = [("a list for a mapping", [1]), ("text for a mapping", "a")]
    if value:
        names = list(value)
        name = names[rng.integers(len(names))]
        label, item = wrong_value(value[name], rng, False)
        without = {key: x for key, x in value.items() if key != name}
        wrong += [(f"without {name!r}", without), (f"{name!r}: {label}", {**value, name: item})] * 3
    return _pick(rng, wrong)


def _wrong_tensor(value: Tensor, rng: np.random.Generator) -> Drawn:
    draw: list[Callable[[Tensor, np.random.Generator], Drawn]] = [_shape, _shape, _dtype, _kind]
    if value.is_floating_point() and value.numel():
        draw.append(_not_finite)
    return _pick(rng, draw)(value, rng)


def _shape(value: Tensor, rng: np.random.Generator) -> Drawn:
    """Another shape: a dimension more, less, or of another size."""
    how, dim = rng.integers(3), int(rng.integers(max(value.ndim, 1)))
    if how == 0 or value.ndim == 0:
        changed = value.unsqueeze(dim if value.ndim else 0).repeat_interleave(2, dim)
    elif how == 1:
        changed = value.select(dim, 0)
    else:
        changed = torch.cat([value, value.narrow(dim, 0, 1)], dim)
    return f"shape {list(changed.shape)}", changed


def _dtype(value: Tensor, rng: np.random.Generator) -> Drawn:
    dtype = _pick(
        rng, [torch.complex64, torch.bool if value.is_floating_point() else torch.float32]
    )
    return f"dtype {dtype}", value.to(dtype)


def _kind(value: Tensor, rng: np.random.Generator) -> Drawn:
    wrong = ("text", None, [[1.0]], 3.5, value.detach().numpy(), {})
    chosen = wrong[rng.integers(len(wrong))]
    return f"{type(chosen).__name__} for a tensor", chosen


def _not_finite(value: Tensor, rng: np.random.Generator) -> Drawn:
    number = _pick(rng, [math.nan, math.inf, -math.inf])
    changed = value.clone()
    changed.view(-1)[int(rng.integers(changed.numel()))] = number
    return f"{number} in a tensor", changed


def _wrong_tensordict(value: TensorDictBase, rng: np.random.Generator) -> Drawn:
    keys = sorted(value.keys(True, True), key=str)
    key = keys[rng.integers(len(keys))]
    if rng.random() < 0.1:
        return "text for a tensordict", "text"
    if rng.random() < 0.3:
        return f"without {key!r}", value.exclude(key)
    label, wrong = _pick(rng, [_shape, _dtype, _not_finite])(value[key].float(), rng)
    # Only the batch's own dimensions are checked by tensordict; what lies behind them is ours.
    if wrong.shape[: value.ndim] != value.shape:
        return f"without {key!r}", value.exclude(key)
    changed = TensorDict(value.to_dict(), batch_size=value.batch_size)
    return f"{key!r}: {label}", changed.set(key, wrong)


def _wrong_array(value: np.ndarray, rng: np.random.Generator) -> Drawn:
    if rng.random() < 0.2:
        return _pick(rng, [("text for an array", "text"), ("None for an array", None)])
    label, wrong = _pick(rng, [_shape, _not_finite])(torch.from_numpy(value).double(), rng)
    return f"array of {label}", wrong.numpy()


_BY_TYPE: dict[type, Callable[[Any, np.random.Generator], Drawn]] = {
    bool: _wrong_bool,
    int: _wrong_int,
    float: _wrong_float,
    str: _wrong_text,
    Path: _wrong_path,
    tuple: _wrong_tuple,
    list: lambda value, rng: _wrong_tuple(tuple(value), rng),
    TensorDictBase: _wrong_tensordict,
    Mapping: _wrong_mapping,
    Tensor: _wrong_tensor,
    np.ndarray: _wrong_array,
}


def wrong_file(good: Path, rng: np.random.Generator) -> Drawn:
    """The path of something else than a good file, written beside it."""
    folder = good.parent
    content = good.read_bytes()
    at = int(rng.integers(len(content)))
    contents = {
        "an empty file": b"",
        "a file of noise": rng.bytes(200),
        "a pickle": pickle.dumps({"a": 1}),
        "a file that is cut short": content[:at],
        "a file with a flipped bit": content[:at] + bytes([content[at] ^ 1]) + content[at + 1 :],
        "a text": b"no such\n",
    }
    choices = [*contents, "no file", "a folder", "a file under a file"]
    label = choices[rng.integers(len(choices))]
    if label == "no file":
        return label, folder / f"missing{good.suffix}"
    if label == "a folder":
        (folder / "folder").mkdir(exist_ok=True)
        return label, folder / "folder"
    if label == "a file under a file":
        return label, good / "inner"
    path = folder / f"wrong{good.suffix}"
    path.write_bytes(contents[label])
    return label, path
