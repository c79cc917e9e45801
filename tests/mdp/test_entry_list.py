"""How the entries of an observation are chosen."""

import pytest

from modpush.mdp import ENTRIES, PAPER_ENTRIES, PATH_ENTRIES, Entry, resolve_entries
from tests.mdp import own_parts


def test_by_default_those_of_the_frame():
    assert tuple(resolve_entries("path")) == PATH_ENTRIES
    assert tuple(resolve_entries("object")) == PAPER_ENTRIES
    assert all(entry is ENTRIES[name] for name, entry in resolve_entries("base").items())


def test_an_ablation_leaves_out_and_adds():
    found = resolve_entries("object", leave_out=["latent", "contact"], add=["edges"])
    names = ["ee_pose", "joint_position", "subgoal_past", "goal_distance", "edges"]
    assert list(found) == names


def test_names_of_ones_own_entries_do_not_depend_on_how_they_are_given():
    by_text = resolve_entries(
        "path", ["tests.mdp.own_parts:speed", "tests.mdp.own_parts:halved_gap"]
    )
    assert by_text == {"speed": Entry(own_parts.speed), "halved_gap": own_parts.halved_gap}
    assert resolve_entries("path", [own_parts.speed]) == {"speed": Entry(own_parts.speed)}
    assert resolve_entries("path", [own_parts.halved_gap]) == {"gap": own_parts.halved_gap}
    pairs = [("one", own_parts.halved_gap), ("two", "contact")]
    assert resolve_entries("path", pairs) == {
        "one": own_parts.halved_gap,
        "two": ENTRIES["contact"],
    }
    assert resolve_entries("path", dict(pairs)) == resolve_entries("path", pairs)


def test_what_cannot_be_resolved_is_refused():
    with pytest.raises(
        ValueError, match=r"cannot leave out \['edges'\], the entries are \['goal'\]"
    ):
        resolve_entries("path", ["goal"], leave_out=["edges"])
    with pytest.raises(ValueError, match="must have different names, got 'goal' twice"):
        resolve_entries("path", ["goal"], add=["goal"])
    with pytest.raises(ValueError, match="entries is empty"):
        resolve_entries("path", ["goal"], leave_out=["goal"])
    with pytest.raises(ValueError, match="needs a name"):
        resolve_entries("path", [lambda inputs: inputs.goal])
    with pytest.raises(ValueError, match=r"entries\[0\]: .* callable .*, got 3"):
        resolve_entries("path", [3])
    with pytest.raises(TypeError, match=r"an entry must be a name, .*, got 3.14"):
        resolve_entries("path", ["math:pi"])
    with pytest.raises(ValueError, match="cannot import 'no_such_module'"):
        resolve_entries("path", ["no_such_module:entry"])
