"""Packages that only some commands need, and warnings for what has never run on a GPU."""

import functools
import importlib.util
import warnings

EXTRAS = {
    "tensorboard": "train",
    "viser": "view",
    "minari": "data",
    "h5py": "data",
    "onnx": "export",
    "onnxscript": "export",
    "onnxruntime": "export",
    "ray": "ray",
    "mujoco": "mujoco",
    "rtde_control": "ur",
    "rtde_receive": "ur",
}
"""The extra of `pip install 'modpush[extra]'` that brings each optional package."""


class MissingExtraError(ImportError):
    """A package that an extra brings is not installed."""


def require_extra(caller: str, *packages: str) -> None:
    """Check that packages of `EXTRAS` are installed, or say what to install; nothing is imported."""
    missing = [name for name in packages if importlib.util.find_spec(name) is None]
    if missing:
        extras = ",".join(sorted({EXTRAS[name] for name in missing}))
        raise MissingExtraError(
            f"{caller}: {', '.join(missing)} not installed; get it with pip install "
            f"'modpush[{extras}]'."
        )


@functools.cache
def warn_experimental(what: str) -> None:
    """Warn, once per process and subject, that something has never been run on a GPU."""
    warnings.warn(
        f"{what} on CUDA is experimental: it has never been run. Check it with `make test-gpu` first, "
        "or use device='cpu'.",
        UserWarning,
        stacklevel=3,
    )
