"""YAML 1.2 in, and the same data out again."""

import math

import pytest
from hypothesis import given, strategies as st

from modpush.files import dump_yaml, load_yaml

READ = {
    "3e-4": 3e-4, "1e3": 1000.0, "-2.5E+2": -250.0, ".5": 0.5, "1.": 1.0, "1_000": 1000,
    "010": 10, "0x1F": 31, "0o17": 15, "+7": 7,
    "true": True, "False": False, "~": None, "": None, "-.inf": -math.inf,
    "off": "off", "yes": "yes", "No": "No", "2026-01-01": "2026-01-01", "1:30": "1:30",
    "1e": "1e", "'3e-4'": "3e-4",
}  # fmt: skip


@pytest.mark.parametrize("text", READ)
def test_scalars(text):
    value = load_yaml(f"a: {text}")["a"]
    assert (value, type(value)) == (READ[text], type(READ[text]))


texts = st.one_of(st.text(max_size=8), st.from_regex(r"[-+.0-9eE_x:~]{1,6}", fullmatch=True))
numbers = st.one_of(st.integers(), st.floats(allow_nan=False), st.booleans(), st.none())


@given(st.dictionaries(texts, st.one_of(texts, numbers)))
def test_what_is_written_is_read_back(data):
    assert load_yaml(dump_yaml(data)) == data


def test_lists_are_merged_as_before():
    assert load_yaml("a: &a {b: 1}\nc: {<<: *a, d: off}")["c"] == {"b": 1, "d": "off"}
