"""Malformed inputs, a sample of those that `benchmarks/reliability/malformed.py` counts."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pandas as pd
import pytest
import torch
from tensordict.nn import TensorDictModule

from modpush.evaluation import compare, format_table
from modpush.mdp import Entry
from modpush.recipes import PushEnvConfig, save_agent
from modpush.replay import cosine, negative_l2
from tests.malformed.cases import judge, light_targets, make_case

COUNT = 280
PAIRS = {"candidates": torch.ones(2, 3, 4), "queries": torch.ones(2, 4)}
ROWS = pd.DataFrame({"a": [1.0]})


def _save(tmp_path: Path, **wrong: Any) -> None:
    right = {
        "policy": TensorDictModule(torch.nn.Identity(), in_keys=["a"], out_keys=["b"]),
        "hidden_sizes": (8,),
        "observation_dim": 3,
        "fingerprint": {},
    }
    save_agent(path=tmp_path / "a.safetensors", config=PushEnvConfig(), **{**right, **wrong})


def test_the_same_number_makes_the_same_case() -> None:
    for number in range(0, COUNT, 40):
        first, again = (make_case(0, number, light_targets()) for _ in range(2))
        assert str(first) == str(again)


def test_malformed_inputs_are_refused_by_clear_errors() -> None:
    found = {}
    for number in range(COUNT):
        case = make_case(0, number, light_targets())
        outcome, text = judge(case)
        name = f"{case.target.name}({case.argument})"
        if outcome != "clear":
            found[name] = f"{outcome}: {case}: {text}"
    assert not found


@pytest.mark.parametrize(
    ("call", "expected"),
    [
        (lambda: cosine(**{**PAIRS, "queries": None}), "cosine: queries must be of type Tensor"),
        (
            lambda: cosine(**{**PAIRS, "candidates": torch.ones(2, 4)}),
            r"cosine: candidates must be \[Q, C, D\], got \[2, 4\]",
        ),
        (
            lambda: negative_l2(**{**PAIRS, "queries": torch.ones(2, 3)}),
            r"negative_l2: queries must be \[Q, D\] for candidates \[Q, C, D\] = .*, got \[2, 3\]",
        ),
        (lambda: Entry(read=3), "Entry: read must be a function, got 3"),  # type: ignore[arg-type]
        (lambda: Entry(read=len, scale=None), "Entry: scale must be"),  # type: ignore[arg-type]
        (lambda: format_table(None), "format_table: table must be of type DataFrame"),  # type: ignore[arg-type]
        (lambda: compare(3, ROWS), "compare: first must be of type DataFrame"),  # type: ignore[arg-type]
        (lambda: compare(ROWS, ROWS, float("nan")), "compare: level must be"),
    ],
)
def test_arguments_are_named(call: Callable[[], Any], expected: str) -> None:
    with pytest.raises((TypeError, ValueError), match=expected):
        call()


@pytest.mark.parametrize(
    ("name", "wrong"),
    [("policy", None), ("hidden_sizes", 3), ("observation_dim", 0), ("fingerprint", 3)],
)
def test_an_agent_is_not_saved_from_wrong_arguments(tmp_path: Path, name: str, wrong: Any) -> None:
    with pytest.raises((TypeError, ValueError), match=f"save_agent: {name} must be"):
        _save(tmp_path, **{name: wrong})
    assert not list(tmp_path.iterdir())
