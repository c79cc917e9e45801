import math

import pytest

from modpush.parts import check_allowed, find_part, part_module, part_name

KNOWN = {"root": math.sqrt}


def test_a_part_is_found_by_name_by_module_and_name_or_is_the_object_itself():
    thing = object()
    assert find_part("who", "root", KNOWN) is math.sqrt
    assert find_part("who", "math:cos", KNOWN) is math.cos
    assert find_part("who", "os.path:join.__name__", KNOWN) == "join"
    assert find_part("who", thing, KNOWN) is thing


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("luck", r"who: there is no 'luck', expected one of \['root'\], or 'module:name'"),
        (":cos", "there is no ':cos'"),
        ("math:", "there is no 'math:'"),
        ("no_such_module:thing", "cannot import 'no_such_module' for 'no_such_module:thing'"),
        ("math:nothing", "'math:nothing' not found: .* has no attribute 'nothing'"),
    ],
)
def test_what_cannot_be_found_is_answered_with_what_there_is(text, message):
    with pytest.raises(ValueError, match=message):
        find_part("who", text, KNOWN)


def test_the_name_of_a_part_finds_it_again():
    own = test_the_name_of_a_part_finds_it_again
    assert part_name("who", math.sqrt, KNOWN) == "root"
    assert part_name("who", math.cos, KNOWN) == "math:cos"
    assert part_name("who", "math:cos", KNOWN) == "math:cos"
    assert find_part("who", part_name("who", own, KNOWN), KNOWN) is own


def test_modules_are_imported_only_if_they_are_allowed():
    assert part_module("a.b:c") == "a.b"
    assert part_module("name") is None
    assert part_module("cuda:0") is None
    check_allowed("who", {"tests.own_parts:one_post": ["math:cos"]}, ("tests", "math"))
    with pytest.raises(ValueError, match=r"who: the file names parts in \['ab'\].*allow=\('ab',\)"):
        check_allowed("who", ["ab:c"], ("a",))
