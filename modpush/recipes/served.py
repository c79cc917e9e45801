"""`ServedPolicy`: a policy that another process serves, in whatever language or library."""

import re
from http.client import HTTPConnection, HTTPException
from typing import Any
from urllib.parse import urlsplit

import torch
from safetensors import SafetensorError
from safetensors.torch import load, save
from tensordict import TensorDictBase

from modpush._validation import checked_arguments

_NAME = re.compile(r"[\w+-][\w.+-]{0,63}")
_MOST = 2**24  # of an answer [bytes]


def is_served(policy: str) -> bool:
    """True for the address of a server."""
    return policy.startswith("http://")


class ServedPolicy:
    """Asks a server for the actions. Example of a server: `examples/serve_policy.py`.

    `GET /` must answer with the policy's name: letters, digits and `_.+-`. `POST /act` gets the tensors
    of the environment, `[B, ...]` each by its key, as the bytes of a safetensors file, and must answer
    with such a file that holds `action`, `[B, 3]` float32 in [-1, 1]. `is_init` `[B, 1]` is true where an
    episode begins.

    Args:
        address: `http://host:port`.
        timeout: Longest time to wait for an answer [s].

    Raises:
        ValueError: If the address has another form, or the server answers with no name.
        ConnectionError: If there is no answer.
    """

    @checked_arguments
    def __init__(self, address: str, timeout: float = 60.0) -> None:
        parts = urlsplit(address)
        if not is_served(address) or parts.hostname is None or parts.path.strip("/"):
            raise ValueError(f"ServedPolicy: expected http://host:port, got {address!r}.")
        self._address, self._timeout = address, timeout
        self._connection: HTTPConnection | None = None
        name = self._ask("GET", "/").decode("utf-8", "replace").strip()
        if not _NAME.fullmatch(name):
            raise ValueError(
                f"ServedPolicy: {address} must answer GET / with a name of letters, digits and _.+-, got "
                f"{name[:80]!r}."
            )
        self.config = name
        """Name of the policy, by which its results are told from others."""

    def __call__(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Write the server's `action`."""
        tensors = {
            key: value.contiguous()
            for key, value in tensordict.items()
            if isinstance(value, torch.Tensor) and isinstance(key, str)
        }
        try:
            answer = load(self._ask("POST", "/act", save(tensors)))
        except SafetensorError as error:
            raise ValueError(
                f"ServedPolicy: {self._address} must answer POST /act with a safetensors file: {error}."
            ) from error
        if "action" not in answer:
            raise ValueError(
                f"ServedPolicy: {self._address} must answer with 'action', got {sorted(answer)}."
            )
        return tensordict.set("action", answer["action"].to(tensordict.device or "cpu"))

    def _ask(self, method: str, path: str, content: bytes | None = None) -> bytes:
        parts = urlsplit(self._address)
        if self._connection is None:
            self._connection = HTTPConnection(
                parts.hostname or "", parts.port or 80, timeout=self._timeout
            )
        try:
            self._connection.request(method, path, content)
            answer = self._connection.getresponse()
            text = answer.read(_MOST)
        except (OSError, HTTPException) as error:
            self._connection.close()
            self._connection = None
            raise ConnectionError(
                f"ServedPolicy: no answer of {self._address}: {type(error).__name__}: {error}. Is the "
                "policy being served there?"
            ) from error
        if answer.status != 200:
            raise ConnectionError(
                f"ServedPolicy: {self._address}{path} answered {answer.status}: "
                f"{text[:500].decode('utf-8', 'replace')}"
            )
        return text

    def __del__(self) -> None:
        """Close the connection."""
        if (connection := getattr(self, "_connection", None)) is not None:
            connection.close()

    def __getstate__(self) -> dict[str, Any]:
        """All but the connection: each process has its own."""
        return {**vars(self), "_connection": None}
