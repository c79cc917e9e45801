"""Reading entries of a tensordict, with one error for a missing one."""

from collections.abc import Iterable

from tensordict import NestedKey, TensorDictBase
from torch import Tensor

__all__ = ["check_spec_has", "read_key"]


def read_key(who: str, tensordict: TensorDictBase, key: NestedKey) -> Tensor:
    """The entry under a key.

    Args:
        who: What reads it, for the error message.
        tensordict: Where it is read.
        key: Its key.

    Raises:
        KeyError: If there is none, with the keys there are.
    """
    value = tensordict.get(key, None)
    if value is None:
        raise KeyError(
            f"{who}: key {key!r} is missing; there are "
            f"{sorted(map(str, tensordict.keys(True, True)))}."
        )
    return value


def check_spec_has(who: str, spec: "TensorDictBase", keys: Iterable[NestedKey]) -> None:
    """Check that an environment emits what a transform reads.

    Args:
        who: What reads, for the error message.
        spec: The environment's observation spec, a `Composite`.
        keys: What is read.

    Raises:
        KeyError: If a key is not in the spec, with the keys there are.
    """
    missing = [key for key in keys if spec.get(key, None) is None]
    if missing:
        raise KeyError(
            f"{who}: the environment does not emit {missing}; it emits "
            f"{sorted(map(str, spec.keys(True, True)))}."
        )
