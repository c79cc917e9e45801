"""The keys that an off-policy learner stores, and a transform that keeps no others."""

from tensordict import NestedKey, TensorDictBase

from modpush._checks import check_instance
from modpush._keys import read_key
from modpush._types import Key
from modpush._validation import check_value

__all__ = ["TRANSITION_KEYS", "KeepTransition"]

TRANSITION_KEYS: tuple[NestedKey, ...] = (
    "observation",
    "action",
    ("next", "observation"),
    ("next", "reward"),
    ("next", "done"),
    ("next", "terminated"),
)
"""Keys of a transition that an off-policy learner needs. All else that `make_push_env` emits is for the
environment itself, for metrics and for the log."""


class KeepTransition:
    """Keeps the keys of `TRANSITION_KEYS` in collected data, for a collector's `postproc`.

    The environment has to emit more, for instance `blocked_bits`, in which it remembers what was
    hidden: drop that after collection, not by a transform in the environment.

    Args:
        *extra: Further keys to keep, such as `"window"` and `("next", "window")`.
    """

    def __init__(self, *extra: NestedKey) -> None:
        for key in extra:
            check_value("extra", key, Key)
        self.keys = (*TRANSITION_KEYS, *extra)

    def __call__(self, data: TensorDictBase) -> TensorDictBase:
        """The same transitions with these keys only; nothing is copied.

        Raises:
            KeyError: If one is missing; the message lists the keys.
        """
        check_instance("data", data, TensorDictBase)
        for key in self.keys:
            read_key(data, key)
        return data.select(*self.keys)
