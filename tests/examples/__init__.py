"""The scripts in `examples/`, which are not part of the package."""

import importlib
import sys
from pathlib import Path
from types import ModuleType

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"


def load_example(name: str) -> ModuleType:
    """Import a script, as `python examples/<name>.py` finds it and the scripts beside it.

    Args:
        name: File name without its ending; `"extending.encoder"` for one in a folder.
    """
    if str(EXAMPLES) not in sys.path:
        sys.path.insert(0, str(EXAMPLES))
    return importlib.import_module(name)
