"""Entries of a tensordict, with one error for a missing one."""

from collections.abc import Iterable

from tensordict import NestedKey, TensorDictBase
from torch import Tensor


def read_key(tensordict: TensorDictBase, key: NestedKey, *last: int) -> Tensor:
    """The entry under a key.

    Raises:
        KeyError: If there is none; the message lists the keys.
        ValueError: If its last dimensions are not `last`, where they are given.
    """
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
    """Check that an environment emits what a transform reads.

    Raises:
        KeyError: If a key is not in the observation spec; the message lists the keys.
    """
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
