"""Columns of an observation by entry, with their shifts and scales."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
import torch
from tensordict import NestedKey, TensorDictBase
from torch import Tensor
from torchrl.data import TensorSpec

from modpush.mdp.observation_entries import Entry


class Layout:
    """Columns, shift and scale of each entry, by values `[..., n]` in the order of the entries.

    Raises:
        ValueError: If the leading dimensions of an entry are not `batch_size`, or its scale or shift has
            another number of components.
    """

    def __init__(
        self, entries: Mapping[str, Entry], values: Sequence[Tensor], batch_size: Sequence[int]
    ) -> None:
        self.columns: dict[str, slice] = {}
        """The columns of each entry by name."""
        self.width = 0
        """Number of columns."""
        for name, value in zip(entries, values, strict=True):
            if value.shape[:-1] != torch.Size(batch_size):
                raise ValueError(
                    f"PushObservation: entry {name!r} must be [..., n] with leading dimensions "
                    f"{list(batch_size)}, got {list(value.shape)}."
                )
            self.columns[name] = slice(self.width, self.width + value.shape[-1])
            self.width += value.shape[-1]
        with torch.inference_mode(False):  # they outlast the mode in which they happen to be made
            self._shift = torch.zeros(self.width, dtype=torch.float32, device="cpu")
            self._scale = torch.ones_like(self._shift)
        self._functions: list[tuple[slice, Callable[[], Tensor]]] = []
        for name, columns in self.columns.items():
            entry = entries[name]
            scale = self._scale.new_tensor(entry.scale)
            _assign(self._scale, columns, scale, f"scale of {name!r}")
            if callable(entry.shift):
                self._functions.append((columns, entry.shift))
            else:
                shift = self._shift.new_tensor(entry.shift)
                _assign(self._shift, columns, shift, f"shift of {name!r}")
        self._given: list[Tensor | None] = [None] * len(self._functions)

    def normalise(self, observation: Tensor) -> Tensor:
        """`(observation - shift) * scale` with those of each column."""
        self._refresh()
        if self._shift.device != observation.device:
            with torch.inference_mode(False):
                self._shift = self._shift.to(observation.device)
                self._scale = self._scale.to(observation.device)
        return (observation - self._shift) * self._scale

    def _refresh(self) -> None:
        """Call the shifts that are functions."""
        for i, (columns, function) in enumerate(self._functions):
            given = function()
            if given is not self._given[i]:
                _assign(self._shift, columns, given, "shift, a function's,")
                self._given[i] = given

    def describe(self) -> list[dict[str, Any]]:
        """Name, columns `[first, last + 1]`, shifts and scales of each entry, as plain data."""
        self._refresh()
        return [
            {
                "name": name,
                "columns": [columns.start, columns.stop],
                "shift": self._shift[columns].tolist(),
                "scale": self._scale[columns].tolist(),
            }
            for name, columns in self.columns.items()
        ]


def _assign(row: Tensor, columns: slice, value: Tensor, what: str) -> None:
    width = columns.stop - columns.start
    if value.dim() and value.shape != (width,):
        raise ValueError(
            f"PushObservation: the {what} must be one number or {width}, got {list(value.shape)}."
        )
    row[columns] = value.to(row)


class ReadRecorder:
    """Stands in for a tensordict, or for a spec, of which zeros are given, and notes what is read.

    `defaults` are values of keys that are not in `source`.
    """

    def __init__(
        self, source: TensorDictBase | TensorSpec, defaults: Mapping[NestedKey, Tensor]
    ) -> None:
        self.read: list[NestedKey] = []
        """The keys that were read, once each."""
        self._source, self._defaults = source, defaults

    def get(self, key: NestedKey, default: Any = None) -> Any:
        """The value under a key, or `default`."""
        value = self._source.get(key, None)
        value = self._defaults.get(key, default) if value is None else value
        if value is not None and key not in self.read:
            self.read.append(key)
        return value.zero() if isinstance(value, TensorSpec) else value

    def keys(self, include_nested: bool = False, leaves_only: bool = False) -> Any:
        """The keys of the source."""
        return self._source.keys(include_nested, leaves_only)


def fingerprint_differences(stored: Mapping[str, Any], now: Mapping[str, Any]) -> list[str]:
    """Differences between two `PushObservation.fingerprint`s in words; an empty list if they agree.

    Numbers agree within 0.1 % or 1e-4, so that rounding on another machine is no difference.

    Args:
        stored: The fingerprint that an agent was trained with.
        now: That of the observation that it is to act on.
    """
    found = [
        f"{name}: {stored[name]!r} -> {now[name]!r}"
        for name in ("frame", "raw")
        if stored[name] != now[name]
    ]
    before, after = stored["entries"], now["entries"]
    names, names_now = [e["name"] for e in before], [e["name"] for e in after]
    if names != names_now:
        return [*found, f"entries: {names} -> {names_now}"]
    for one, other in zip(before, after, strict=True):
        widths = len(one["shift"]), len(other["shift"])
        if widths[0] != widths[1]:
            return [*found, f"values of {one['name']!r}: {widths[0]} -> {widths[1]}"]
        for field in ("shift", "scale"):
            if not np.allclose(one[field], other[field], rtol=1e-3, atol=1e-4):
                found.append(f"{field} of {one['name']!r}: {one[field]} -> {other[field]}")
    return found
