"""Base classes of the transforms."""

from abc import abstractmethod
from typing import Any

import torch
from tensordict import NestedKey, TensorDictBase
from torchrl.data import TensorSpec, Unbounded
from torchrl.envs import Transform

from modpush._keys import stored_next

__all__ = ["DescribedTransform", "StatelessTransform", "add_unbounded", "settings_text"]


class DescribedTransform(Transform):
    """A transform that tells its settings: implement `describe`.

    The fingerprint of an agent, the card of an exported agent and `print(env)` read them.
    """

    @abstractmethod
    def describe(self) -> dict[str, Any]:
        """The settings as plain data for JSON, under one name: `{"window": {"size": 64, ...}}`."""

    def __repr__(self) -> str:
        settings = [text for value in self.describe().values() for text in settings_text(value)]
        return f"{type(self).__name__}({', '.join(settings)})"


class StatelessTransform(DescribedTransform):
    """A transform whose output depends on entries of the same step alone.

    A subclass implements TorchRL's `_call`, which serves resets, steps and stored data.
    """

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Write the entries of stored data anew and, in transitions, those of their `"next"`."""
        after = stored_next(tensordict, self.in_keys, self.out_keys)
        if after is not None:
            self._call(after)
        return self._call(tensordict)

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        return self._call(tensordict_reset)


def settings_text(settings: Any) -> list[str]:
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
