"""Connection to a Ray cluster."""

import os
import socket
from collections.abc import Iterator
from contextlib import contextmanager
from types import ModuleType
from urllib.parse import urlsplit

from modpush._extras import require_extra

__all__ = ["RESTARTS", "ray_session"]

RESTARTS = 10
"""Number of times that Ray restarts an actor that has ended."""


@contextmanager
def ray_session(caller: str, least: int) -> Iterator[ModuleType]:
    """The package `ray`, connected to a cluster of at least `least` CPUs within a block.

    Ray looks for a cluster in `RAY_ADDRESS` and on this machine, and else starts one here. A connection
    that exists already is used and kept.

    Raises:
        MissingExtraError: If Ray is not installed.
        RuntimeError: If there is no connection, or the cluster has fewer CPUs.
    """
    require_extra(caller, "ray")
    import ray

    own = not ray.is_initialized()
    try:
        if own:
            _check_address(os.environ.get("RAY_ADDRESS", ""))
            ray.init(include_dashboard=False, log_to_driver=False)
        cpus = ray.cluster_resources().get("CPU", 0)
    except Exception as error:  # Ray's own kinds differ with what went wrong
        raise RuntimeError(f"{caller}: no connection to Ray: {error}") from error
    try:
        if cpus < least:
            raise RuntimeError(f"{caller}: {least} CPUs are needed, Ray has {cpus:g}.")
        yield ray
    finally:
        if own:
            ray.shutdown()


def _check_address(address: str) -> None:
    """Refuse an address at which nothing answers: `ray.init` would wait for it without end."""
    where = urlsplit(address if "://" in address else f"ray://{address}")
    if where.hostname and where.port:
        try:
            socket.create_connection((where.hostname, where.port), 5.0).close()
        except OSError as error:
            raise ConnectionError(f"nothing answers at {address} (RAY_ADDRESS), {error}") from None
