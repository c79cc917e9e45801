from .definition import Sweep as Sweep
from .definition import Trial as Trial
from .definition import Variant as Variant
from .definition import load_sweep as load_sweep
from .definition import override as override
from .results import sweep_curves as sweep_curves
from .results import sweep_results as sweep_results
from .runner import run_sweep as run_sweep
