from .definition import (
    Sweep as Sweep,
    Trial as Trial,
    Variant as Variant,
    load_sweep as load_sweep,
    override as override,
)
from .results import sweep_curves as sweep_curves, sweep_results as sweep_results
from .runner import run_sweep as run_sweep
