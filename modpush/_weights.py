"""Checking weights that come from a file before a network takes them over."""

from collections.abc import Mapping

from torch import Tensor

__all__ = ["check_weights"]


def check_weights(source: object, own: Mapping[str, Tensor], given: Mapping[str, Tensor]) -> None:
    """Refuse weights that a network cannot take over as they are.

    Args:
        source: File that the weights come from, for errors.
        own: The network's `state_dict`.
        given: The weights from a file.

    Raises:
        ValueError: If a weight is missing, unknown, of another shape or dtype, or not finite.
    """
    own = {name: value for name, value in own.items() if isinstance(value, Tensor)}
    missing, unknown = sorted(set(own) - set(given)), sorted(set(given) - set(own))
    if missing or unknown:
        raise ValueError(f"{source}: weights missing {missing}, unknown {unknown}.")
    for name, value in own.items():
        found = given[name]
        if found.shape != value.shape:
            raise ValueError(
                f"{source}: weights of another architecture: {name} must be {list(value.shape)}, "
                f"got {list(found.shape)}."
            )
        if found.dtype != value.dtype:
            raise ValueError(f"{source}: {name} must be {value.dtype}, got {found.dtype}.")
        if not found.isfinite().all():
            count = int((~found.isfinite()).sum())
            raise ValueError(
                f"{source}: {name} must be finite, {count} values are NaN or infinite."
            )
