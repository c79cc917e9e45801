"""Random number generators of a batch of scenes."""

from collections.abc import Sequence

import numpy as np

from modpush._types import Seed
from modpush._validation import check_value

__all__ = ["make_generators", "restart_generators"]


def make_generators(seed: int | Sequence[int] | None, count: int) -> list[np.random.Generator]:
    """A generator for each scene.

    Args:
        seed: One for each scene; or that of the first, alone or in a list, from which scene `i` gets
            `seed + i`; or None for unpredictable numbers.
        count: Number of scenes.

    Raises:
        ValueError: If there is neither one seed nor one per scene, or one is not a whole number >= 0.
    """
    if seed is None:
        return [np.random.default_rng(s) for s in np.random.SeedSequence().spawn(count)]
    seeds = [seed] if isinstance(seed, int | np.integer) else list(seed)
    for one in seeds:
        check_value("seed", one.item() if isinstance(one, np.generic) else one, Seed)
    if len(seeds) == 1:
        seeds = [seeds[0] + i for i in range(count)]
    if len(seeds) != count:
        raise ValueError(
            f"seed must be one number, or one for each of the {count} scenes, got {len(seeds)}."
        )
    return [np.random.default_rng(s) for s in seeds]


def restart_generators(
    generators: list[np.random.Generator], indices: Sequence[int], seed: int | None
) -> None:
    """Seed the generators of some scenes anew, that of scene i with `seed + i`; None leaves them.

    Raises:
        ValueError: If the seed is not a whole number >= 0.
    """
    if check_value("seed", seed, Seed | None) is not None:
        for i in indices:
            generators[i] = np.random.default_rng(int(seed) + i)  # type: ignore[arg-type]  # checked
