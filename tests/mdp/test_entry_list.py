"""How the entries of an observation are chosen."""

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


def test_names_of_your_own_entries_do_not_depend_on_how_they_are_given():
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
