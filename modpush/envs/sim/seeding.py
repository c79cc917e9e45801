"""Random number generators of a batch of scenes."""

from collections.abc import Sequence

import numpy as np

__all__ = ["make_generators"]


def make_generators(seed: int | Sequence[int] | None, count: int) -> list[np.random.Generator]:
    """A generator for each scene.

    Args:
        seed: One for each scene; or that of the first, from which scene `i` gets `seed + i`; or None
            for unpredictable numbers.
        count: Number of scenes.
    """
    if seed is None:
        return [np.random.default_rng(s) for s in np.random.SeedSequence().spawn(count)]
    seeds = [seed] if isinstance(seed, int | np.integer) else list(seed)
    if len(seeds) != count:
        seeds = [seeds[0] + i for i in range(count)]
    return [np.random.default_rng(s) for s in seeds]
