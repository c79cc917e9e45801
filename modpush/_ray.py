"""Being connected to Ray for a while."""

import os
import socket
from collections.abc import Iterator
from contextlib import contextmanager
from types import ModuleType
from urllib.parse import urlsplit

from modpush._extras import require_extra

__all__ = ["ray_session"]

_PATIENCE = 5.0
"""Time limit for a connection to a cluster [s]."""


@contextmanager
def ray_session(who: str, least: int) -> Iterator[ModuleType]:
    """Ray, connected to the cluster that it finds or else begun on this machine, and ended if so.

    Ray looks for a cluster in the variable `RAY_ADDRESS` and on this machine. A connection that is there
    already is used, and left.

    Args:
        who: What needs it, for error messages.
        least: Number of CPUs that the cluster must have.

    Yields:
        The package `ray`.

    Raises:
        MissingExtraError: If Ray is not installed.
        RuntimeError: If there is no connection, or the cluster has fewer CPUs than that; the
            message has what Ray says.
    """
    require_extra(who, "ray")
    import ray

    own = not ray.is_initialized()
    if own:
        if gone := _no_answer():  # `ray.init` would wait for it without end
            raise RuntimeError(f"{who}: no connection to Ray: {gone}")
        try:
            ray.init(include_dashboard=False, log_to_driver=False)
        except Exception as error:  # Ray's own kinds differ with what went wrong
            ray.shutdown()
            reason = str(error).strip().splitlines() or [type(error).__name__]
            raise RuntimeError(f"{who}: no connection to Ray: {_refusal() or reason[0]}") from error
    try:
        cpus = ray.cluster_resources().get("CPU", 0)
        if cpus < least:
            raise RuntimeError(f"{who}: {least} CPUs are needed, Ray has {cpus:g}.")
        yield ray
    finally:
        if own:
            ray.shutdown()


def _no_answer() -> str | None:
    """Why the cluster that `RAY_ADDRESS` names cannot be reached; None if it can, or none is named."""
    address = os.environ.get("RAY_ADDRESS", "")
    where = urlsplit(address if "://" in address else f"ray://{address}")
    try:
        if where.hostname and where.port:
            socket.create_connection((where.hostname, where.port), _PATIENCE).close()
    except (OSError, ValueError) as error:
        return f"nothing answers at {address}, which RAY_ADDRESS names ({error})."
    return None


def _refusal() -> str | None:
    """What the cluster says if it is there and refuses this process's token, which `ray.init` hides."""
    from ray._raylet import GcsClient  # type: ignore[attr-defined]
    from ray.exceptions import AuthenticationError

    address = os.environ.get("RAY_ADDRESS", "")
    if not address or "://" in address:
        return None
    try:
        GcsClient(address=address).check_alive([], 2)
    except AuthenticationError as error:
        return f"{address} refuses the token: {error}"
    except Exception:
        return None
    return None
