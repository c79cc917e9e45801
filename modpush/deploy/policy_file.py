"""`load_policy`: an agent by name, from its file, or from a folder of `modpush export`."""

import json
from pathlib import Path
from typing import Any

import torch
from tensordict.nn import TensorDictModule
from torch import Tensor

from modpush._extras import require_extra
from modpush._validation import from_plain
from modpush.parts import check_allowed
from modpush.recipes.agent_file import Agent, load_agent
from modpush.recipes.config import PushEnvConfig


def load_policy(source: str | Path) -> Agent:
    """Load an agent for `PushController`.

    Args:
        source: What `load_agent` takes, or a folder with `policy.onnx` and `card.json`, as
            `modpush export` writes them. The graph runs in onnxruntime.

    Raises:
        ValueError: If there is no such agent, or the card cannot be read.
        MissingExtraError: If onnxruntime is needed and not installed.
    """
    folder = Path(source)
    return _exported(folder) if (folder / "card.json").is_file() else load_agent(source)


def _exported(folder: Path) -> Agent:
    try:
        card = json.loads((folder / "card.json").read_text(encoding="utf-8"))
        check_allowed(f"load_policy: {folder / 'card.json'}", card["environment"])
        config = from_plain(PushEnvConfig, card["environment"])
        fingerprint = dict(card["fingerprint"])
    except (OSError, ValueError, LookupError, TypeError) as error:
        raise ValueError(
            f"load_policy: {folder / 'card.json'} must be a card of `modpush export`, of this version: "
            f"{error}"
        ) from None
    if not (folder / "policy.onnx").is_file():
        raise ValueError(
            f"load_policy: {folder} must hold policy.onnx beside card.json; export with --format onnx."
        )
    actor: Any = TensorDictModule(
        _onnx_policy(folder / "policy.onnx"), in_keys=["observation"], out_keys=["action"]
    )
    return Agent(actor=actor, config=config, metadata={}, fingerprint=fingerprint)


def _onnx_policy(path: Path) -> Any:
    require_extra("load_policy: an exported policy", "onnxruntime")
    import onnxruntime

    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = 1
    session = onnxruntime.InferenceSession(path, options)

    def act(observation: Tensor) -> Tensor:
        (action,) = session.run(["action"], {"observation": observation.numpy()})
        return torch.from_numpy(action)

    return act
