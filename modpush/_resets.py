"""Transforms at a partial reset: work for the scenes that are reset alone."""

from collections.abc import Callable, Sequence

import torch
from tensordict import NestedKey, TensorDictBase
from torch import Tensor

__all__ = ["scenes_reset", "write_scenes_reset"]


def scenes_reset(tensordict: TensorDictBase, batch_size: torch.Size) -> Tensor | None:
    """Mask of the scenes of a batch `[B]` that are being reset.

    Args:
        tensordict: First argument of `Transform._reset`, with TorchRL's `"_reset"` where there is one.
        batch_size: Batch size of the environment.

    Returns:
        `[B]` bool; None where all are, or where scenes are not in one row.
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
        tensordict: First argument of `Transform._reset`.
        tensordict_reset: Its second one, which is written and returned.
        in_keys: What `write` reads.
        out_keys: What it writes.
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
