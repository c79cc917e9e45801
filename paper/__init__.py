"""Comparison with the paper: its printed results, its authors' yardsticks, tables, tests and sweeps.

A user of the library that runs from a clone, as `python -m paper`; it is not part of the wheel.
"""

import warnings

warnings.filterwarnings(
    "ignore", message="Failed to find system libvulkan"
)  # SAPIEN brings its own
