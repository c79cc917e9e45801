"""Files made to do harm behind a right seal: another structure, or sizes that no machine has."""

import copy
import json
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from modpush import files
from modpush.encoders import DepthVAE
from modpush.evaluation.sets import load_set
from modpush.files import (
    read_arrays,
    read_packed_json,
    read_tensors,
    read_yaml,
    write_arrays,
    write_packed_json,
    write_tensors,
)
from modpush.recipes import load_agent
from modpush.training import TRAIN_PRESETS
from modpush.training.run_folder import RunFolder
from modpush.training.warm_start import load_initial_weights
from tests.damage import KINDS

SMOKE = TRAIN_PRESETS["smoke"]


def write_tensor_config(path: Path, data: Any, kind: str, version: int) -> None:
    write_tensors(path, {}, kind, version, data)


def write_json(path: Path, data: Any, kind: str, version: int) -> None:
    """JSON, which is YAML as well, of anything."""
    about = {"format": f"{kind} v{version}"}
    path.write_text(json.dumps({**about, **data} if isinstance(data, dict) else data))


def write_packed(path: Path, data: Any, kind: str, version: int) -> None:
    write_packed_json(path, data)


def start_from(path: Path) -> None:
    load_initial_weights(None, replace(SMOKE, init_from=str(path)), None, {})  # type: ignore[arg-type]


READERS: dict[str, tuple[str, int, Callable[..., None], Callable[[Path], object]]] = {
    "a.safetensors": ("modpush.Agent", 5, write_tensor_config, load_agent),
    "vae.safetensors": ("modpush.DepthVAE", 2, write_tensor_config, DepthVAE.from_pretrained),
    "step-1.safetensors": ("modpush.Checkpoint", 1, write_tensor_config, start_from),
    "set.json.gz": ("modpush.EvaluationSet", 3, write_packed, load_set),
    "config.yaml": (
        "modpush.TrainConfig",
        1,
        write_json,
        lambda path: RunFolder(path.parent).stored_config(),
    ),
}
"""By name of the file: kind, version, and what writes and reads it."""


def nested(depth: int) -> Any:
    data: Any = []
    for _ in range(depth):
        data = [data] if depth % 2 else {"list": [data]}
    return data


WRONG = {
    "nothing": None,
    "a number": 3,
    "a text": "modpush",
    "a list": [],
    "nothing in it": {},
    "values of other types": {
        **dict.fromkeys(("name", "conditions", "episodes", "about", "scenario"), 3),
        **dict.fromkeys(("env", "network", "parts", "fingerprint", "metadata", "make_env"), 3),
        **dict.fromkeys(("latent_dim", "encoder_widths", "decoder_widths", "sample"), 3),
    },
    "another kind of key": {"dict": [[{"list": []}, 1]]},
    "no such device": {"device": "hal:9000"},
    "no such tensor": {"tensor": "7"},
    "a short dict": {"dict": [[1]]},
    "lists in lists": nested(9001),
    "mappings in mappings": nested(4000),
}


@pytest.mark.parametrize("wrong", WRONG)
@pytest.mark.parametrize("name", READERS)
def test_another_structure_is_refused_by_name(tmp_path: Path, name: str, wrong: str) -> None:
    kind, version, write, read = READERS[name]
    limit = sys.getrecursionlimit()
    sys.setrecursionlimit(50_000)
    try:
        write(tmp_path / name, WRONG[wrong], kind, version)
    finally:
        sys.setrecursionlimit(limit)
    with pytest.raises(ValueError, match=name):
        read(tmp_path / name)


def places(data: Any) -> list[list[Any]]:
    """The ways to all values in nested data."""
    items = (
        data.items()
        if isinstance(data, dict)
        else enumerate(data)
        if isinstance(data, list)
        else ()
    )
    return [[], *([key, *rest] for key, value in items for rest in places(value))]


def is_refused(path: Path) -> bool:
    try:
        load_agent(path)
    except ValueError as error:
        return path.name in str(error) or pytest.fail(f"the error does not name the file: {error}")
    return False


def test_an_agent_s_file_with_any_value_of_another_type_loads_or_is_refused_by_name(
    tmp_path: Path,
) -> None:
    path, _ = KINDS["agent"](tmp_path)
    tensors, about = read_tensors(path, "modpush.Agent", 5)
    refused = 0
    ways = [way for way in places(about) if way]
    for way in ways:
        for value in (None, [], {"a": [{}]}, -1):
            changed = copy.deepcopy(about)
            inside = changed
            for key in way[:-1]:
                inside = inside[key]
            inside[way[-1]] = value
            write_tensors(path, tensors, "modpush.Agent", 5, changed)
            refused += is_refused(path)
    assert refused > 2 * len(ways)


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("hidden_sizes", [10**12]),
        ("hidden_sizes", [10**6, 10**6]),
        ("hidden_sizes", [2**61, 2**61]),
        ("hidden_sizes", [8] * 100_000),
        ("observation_dim", 10**12),
    ],
)
def test_an_agent_of_a_size_that_its_file_does_not_hold_takes_no_memory(
    tmp_path: Path, field: str, value: Any
) -> None:
    path, _ = KINDS["agent"](tmp_path)
    tensors, about = read_tensors(path, "modpush.Agent", 5)
    about["network"][field] = value
    write_tensors(path, tensors, "modpush.Agent", 5, about)
    with pytest.raises(ValueError, match=r"agent.safetensors"):
        load_agent(path)


@pytest.mark.parametrize(
    "change", [{"latent_dim": 10**12}, {"encoder_widths": [10**6, 10**6, 10**6, 10**6]}]
)
def test_an_encoder_of_a_size_that_its_file_does_not_hold_takes_no_memory(
    tmp_path: Path, change: dict[str, Any]
) -> None:
    path, _ = KINDS["VAE weights"](tmp_path)
    tensors, about = read_tensors(path, "modpush.DepthVAE", 2)
    write_tensors(path, tensors, "modpush.DepthVAE", 2, {**about, **change})
    with pytest.raises(ValueError, match=r"vae.safetensors"):
        DepthVAE.from_pretrained(path)


def test_what_unpacks_to_more_than_a_bound_is_refused(tmp_path: Path, monkeypatch) -> None:
    text, arrays = tmp_path / "set.json.gz", tmp_path / "arrays.npz"
    write_packed_json(text, [0] * 100_000)
    write_arrays(arrays, {"a": np.zeros(100_000)})
    monkeypatch.setattr(files, "_MOST_TEXT", 100_000)
    monkeypatch.setattr(files, "_MOST_ARRAYS", 100_000)
    with pytest.raises(ValueError, match=r"set.json.gz .*more than 100000 bytes"):
        read_packed_json(text, "modpush.Thing")
    with pytest.raises(ValueError, match=r"arrays.npz .*expected at most 100000"):
        read_arrays(arrays, "modpush.Thing")


BOMB = "\n".join(["a0: &a0 [0]", *(f"a{i + 1}: &a{i + 1} [*a{i}, *a{i}]" for i in range(20))])
ITSELF = "a: &a [*a]"


@pytest.mark.parametrize("text", [BOMB, ITSELF])
def test_a_few_lines_of_yaml_that_stand_for_a_million_are_refused(
    tmp_path: Path, text: str
) -> None:
    (tmp_path / "config.yaml").write_text(text)
    with pytest.raises(ValueError, match=r"config.yaml .*values of YAML"):
        read_yaml(tmp_path / "config.yaml", "modpush.Thing")
