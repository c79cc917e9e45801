"""What several transforms do alike."""

import torch
from tensordict import NestedKey, TensorDictBase
from torchrl.data import TensorSpec, Unbounded
from torchrl.envs import Transform

from modpush._keys import stored_next

__all__ = ["StatelessTransform", "add_unbounded"]


class StatelessTransform(Transform):
    """A transform whose output depends on entries of the same step alone.

    A subclass implements TorchRL's `_call`, which serves resets, steps and stored data.
    """

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Write the entries of stored data anew and, in transitions, those of their `"next"`."""
        after = stored_next(type(self).__name__, tensordict, self.in_keys, self.out_keys)
        if after is not None:
            self._call(after)
        return self._call(tensordict)

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        return self._call(tensordict_reset)


def add_unbounded(spec: TensorSpec, key: NestedKey, *size: int) -> None:
    """Add an entry of real numbers, `[*B, *size]` float32, to a spec of shape `[*B]`."""
    spec[key] = Unbounded(shape=(*spec.shape, *size), dtype=torch.float32, device=spec.device)
