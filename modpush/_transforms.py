"""Base classes of the transforms, and partial resets: work for the scenes that are reset alone."""

from abc import abstractmethod
from collections.abc import Callable, Sequence
from typing import Any

import torch
from tensordict import NestedKey, TensorDictBase
from torch import Tensor
from torchrl.data import TensorSpec, Unbounded
from torchrl.envs import Transform

from modpush._checks import stored_next


class DescribedTransform(Transform):
    """A transform that tells its settings: implement `describe`.

    The fingerprint of an agent, the card of an exported agent and `print(env)` read them.
    """

    @abstractmethod
    def describe(self) -> dict[str, Any]:
        """The settings as plain data for JSON, under one name: `{"window": {"size": 64, ...}}`."""

    def __repr__(self) -> str:
        settings = [text for value in self.describe().values() for text in _settings_text(value)]
        return f"{type(self).__name__}({', '.join(settings)})"


class StatelessTransform(DescribedTransform):
    """A transform whose output depends on entries of the same step alone.

    A subclass implements TorchRL's `_call`, which serves resets, steps and stored data.
    """

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Rewrite the entries of stored data and, in transitions, those of their `"next"`."""
        after = stored_next(tensordict, self.in_keys, self.out_keys)
        if after is not None:
            self._call(after)
        return self._call(tensordict)

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        return self._call(tensordict_reset)


def _settings_text(settings: Any) -> list[str]:
    """Plain data as arguments of a call, `name=value`; of parts that have a name, their names."""
    if not isinstance(settings, dict):
        return [repr(settings)]
    texts = []
    for name, value in settings.items():
        if isinstance(value, list) and value and all(isinstance(v, dict) for v in value):
            value = [v["name"] for v in value]
        texts.append(f"{name}={value!r}")
    return texts


def add_unbounded(spec: TensorSpec, key: NestedKey, *size: int) -> None:
    """Add an entry of real numbers, `[*B, *size]` float32, to a spec of shape `[*B]`."""
    spec[key] = Unbounded(shape=(*spec.shape, *size), dtype=torch.float32, device=spec.device)


def scenes_reset(tensordict: TensorDictBase, batch_size: torch.Size) -> Tensor | None:
    """Mask of the scenes of a batch that are being reset, `[B]` bool.

    None where all are, or where scenes are not in one row. `tensordict` is the first argument of
    `Transform._reset`, with TorchRL's `"_reset"` where there is one.
    """
    mask = tensordict.get("_reset", None)
    if mask is None or len(batch_size) != 1:
        return None
    mask = mask.reshape(*batch_size, -1).any(-1)
    return None if mask.all() or not mask.any() else mask


def write_scenes_reset(
    write: Callable[[TensorDictBase], TensorDictBase],
    tensordict: TensorDictBase,
    tensordict_reset: TensorDictBase,
    in_keys: Sequence[NestedKey],
    out_keys: Sequence[NestedKey],
    at_least: int = 1,
) -> TensorDictBase:
    """Let a stateless transform write its entries for the scenes that are being reset.

    TorchRL puts back the old values of the others afterwards; until then they are given those of the
    first scene that is reset, so that what comes next finds valid numbers everywhere.

    Args:
        write: Reads `in_keys` and writes `out_keys`, scene by scene.
        tensordict, tensordict_reset: Arguments of `Transform._reset`; the second one is written.
        in_keys, out_keys: Keys that `write` reads and writes.
        at_least: Number of scenes in a call of `write`, if there are as many; some are written twice.
    """
    mask = scenes_reset(tensordict, tensordict_reset.batch_size)
    if mask is None or mask.sum() + at_least > len(mask):
        return write(tensordict_reset)
    rows = mask.nonzero().flatten()
    padding = rows[:1].expand(max(0, at_least - len(rows)))
    part = tensordict_reset.select(*in_keys, strict=False)[torch.cat([rows, padding])]
    write(part)
    place = torch.zeros(len(mask), dtype=torch.long, device=mask.device)
    place[rows] = torch.arange(len(rows), device=mask.device)
    for key in out_keys:
        tensordict_reset.set(key, part.get(key)[place])
    return tensordict_reset
