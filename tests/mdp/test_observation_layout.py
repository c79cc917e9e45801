"""What an observation's columns mean, as plain data."""

import json

import pytest
import torch

from modpush.mdp import Entry, PushObservation, fingerprint_differences
from tests.mdp.test_push_observation import make_state


def fingerprint(*args, **kwargs):
    observe = PushObservation(*args, **kwargs)
    observe(make_state())
    return observe.describe()["observation"]


def test_a_fingerprint_survives_json_and_tells_each_column():
    own = ("own", Entry(lambda inputs: inputs.goal, scale=(2.0, 4.0), shift=0.5))
    stored = json.loads(json.dumps(fingerprint("path", entries=["contact", own])))
    assert stored == {
        "frame": "path",
        "raw": False,
        "entries": [
            {"name": "contact", "columns": [0, 1], "shift": [0.0], "scale": [1.0]},
            {"name": "own", "columns": [1, 3], "shift": [0.5, 0.5], "scale": [2.0, 4.0]},
        ],
    }


def test_other_frames_widths_and_scales_differ_and_rounding_does_not():
    def entry(scale):
        return [("own", Entry(lambda inputs: inputs.goal, scale=scale))]

    stored = fingerprint(entries=entry(2.0))
    assert fingerprint_differences(stored, fingerprint(entries=entry(2.000001))) == []
    assert fingerprint_differences(stored, fingerprint(entries=entry((2.0, 3.0)))) == [
        "scale of 'own': [2.0, 2.0] -> [2.0, 3.0]"
    ]
    assert fingerprint_differences(stored, fingerprint("path", entries=entry(2.0), raw=True)) == [
        "frame: 'object' -> 'path'",
        "raw: False -> True",
    ]
    wide = fingerprint(entries=[("own", Entry(lambda inputs: inputs.latent, scale=2.0))])
    found = fingerprint_differences(stored, wide)
    assert found == ["values of 'own': 2 -> 32"]


def test_a_function_as_shift_is_called_for_each_observation():
    given = [torch.tensor([1.0, 2.0]), torch.tensor([1.0])]
    state = make_state()
    state["goal_position"] = state["object_pose"][:, :2]
    entry = Entry(lambda inputs: inputs.goal, shift=lambda: given[0])
    observe = PushObservation("base", entries=[("own", entry)])
    assert torch.equal(observe(state)["observation"], torch.tensor([[-1.0, -2.0]] * 2))
    given[0] = torch.tensor([3.0, 0.0])
    assert torch.equal(observe(state)["observation"], torch.tensor([[-3.0, 0.0]] * 2))
    assert observe.describe()["observation"]["entries"][0]["shift"] == [3.0, 0.0]
    given[0] = given[1]
    with pytest.raises(ValueError, match=r"must be one number or 2, got \[1\]"):
        observe(state)
