"""Which actions the contact filter changes, and into what."""

import math
import pickle

import numpy as np
import pytest
import torch
from tensordict import TensorDict
from torchrl.envs import check_env_specs
from torchrl.envs.utils import step_mdp

from modpush import load_agent, make_push_env
from modpush.envs.scenes.objects import get_object
from modpush.evaluation import generate_set
from modpush.geometry.camera import CAMERA
from modpush.geometry.workspace import WORKSPACE, Rectangle
from modpush.mdp import ContactFilter
from modpush.mdp.escape import escape
from modpush.mdp.push_prediction import PARTS, object_after, outline, start, tip_at

TIP = (0.032, 0.011)
BOX = torch.from_numpy(get_object("box").support.astype(np.float32))


def blocked(*squares, side=0.05):
    """Bits of a map with squares around the given places."""
    centres = np.stack(np.meshgrid(np.arange(256), np.arange(256)), -1)  # (u, v)
    places = CAMERA.unproject(centres.astype(np.float64))
    cells = np.zeros((256, 256), bool)
    for square in squares:
        cells |= (np.abs(places - square) < side / 2).all(-1)
    return torch.from_numpy(np.packbits(cells, axis=1, bitorder="little"))[None]


def scene(action, tip, thing=(0.3, 0.3, 0.0), bits=None, **more):
    entries = {
        "action": torch.tensor([action]),
        "ee_pose": torch.tensor([tip]),
        "object_pose": torch.tensor([thing]),
        "object_support": BOX[None],
        "blocked_bits": blocked() if bits is None else bits,
        **{key: torch.tensor([value]) for key, value in more.items()},
    }
    return TensorDict(entries, [1])


def filtered(*args, **kwargs):
    return ContactFilter(TIP, WORKSPACE.bounds()).inv(scene(*args, **kwargs))["action"][0]


def test_an_action_without_a_contact_stays() -> None:
    action = [0.3, -0.9, 0.5]
    assert filtered(action, (0.5, 0.0, 0.0)).tolist() == pytest.approx(action)


def test_the_tool_stops_or_turns_aside_before_an_obstacle() -> None:
    bits = blocked((0.5, 0.1))  # from y = 0.075 on; the tool's side is at 0.011
    tip = (0.5, 0.05, 0.0)
    action = filtered([0.0, 1.0, 0.0], tip, bits=bits)
    assert 0.05 + 0.011 + 0.02 * float(action[1]) < 0.075 - 0.006 + 0.004  # half a cell is 1.8 mm
    assert filtered([0.0, -1.0, 0.0], tip, bits=bits).tolist() == [0.0, -1.0, 0.0]


def test_parts_of_the_tool_at_the_obstacles_height_keep_their_distance() -> None:
    """The linkage of the gripper over a flat object reaches 3 cm farther along x than its tip."""
    bits = blocked((0.5, 0.1))  # from y = 0.075 on
    tip = (0.5, 0.02, math.pi / 2)  # its long side along y
    free = filtered([0.0, 1.0, 0.0], tip, bits=bits, tool_half_extents=list(TIP))
    assert free.tolist() == filtered([0.0, 1.0, 0.0], tip, bits=bits).tolist()
    near = filtered([0.0, 1.0, 0.0], tip, bits=bits, tool_half_extents=[0.062, 0.0135])
    assert free.tolist() == pytest.approx([0.0, 0.5, 0.0])  # at full speed it would come to 3 mm
    assert float(near[1]) < 0.0  # it is over the obstacle's edge already


def test_a_turn_alone_is_seen() -> None:
    """The end of a tool of 40 cm moves by 10 mm."""
    bits = blocked((0.7, 0.01 + 0.008 + 0.025))  # 8 mm beside its end
    long_tool = ContactFilter((0.2, 0.01), WORKSPACE.bounds())
    state = scene([0.0, 0.0, 1.0], (0.5, 0.0, 0.0), bits=bits)
    assert float(long_tool.filter(state, state["action"])[0, 2]) <= 0.0
    back = state["action"] * -1.0
    assert torch.equal(long_tool.filter(state, back), back)


def test_the_object_is_not_pushed_against_an_obstacle() -> None:
    # The box reaches from y = -0.025 to 0.025, the tool touches it from below.
    tip, thing, push = (0.5, -0.036, 0.0), (0.5, 0.0, 0.0), [0.0, 1.0, 0.0]
    assert filtered(push, tip, thing).tolist() == push
    action = filtered(push, tip, thing, bits=blocked((0.5, 0.06)))  # from y = 0.035 on
    assert float(action[1]) < 0.5


def test_an_object_near_an_obstacle_is_pushed_along_it_and_no_nearer() -> None:
    """Between box and obstacle are 7 or 11 mm, where 1 cm and 4 mm for the motion are kept."""
    for y, speed in ((0.056, 0.5), (0.06, 1.0)):
        bits = blocked((0.5, y))
        beside, below = (0.4385, 0.0, math.pi / 2), (0.5, -0.0365, 0.0)
        along = filtered([1.0, 0.0, 0.0], beside, (0.5, 0.0, 0.0), bits=bits)
        assert along.tolist() == [speed, 0.0, 0.0]
        nearer = filtered([0.0, 1.0, 0.0], below, (0.5, 0.0, 0.0), bits=bits)
        assert float(nearer[1]) < 0.2


def test_a_push_that_was_refused_for_long_is_allowed_unless_something_would_touch() -> None:
    """A box is pushed along an obstacle or against it."""
    along, against = (0.5 - 0.088, 0.0, 0.0), (0.5, -0.036, 0.0)
    for gap, steps, share in [
        (0.004, 0.0, 0.0),
        (0.004, 30.0, 0.0),
        (0.004, 60.0, 0.5),  # no faster, since the prediction may be wrong by a fifth of the motion
    ]:
        bits, stalled = blocked((0.5, 0.025 + gap + 0.025)), [0.5, 0.0, steps]
        action = filtered([1.0, 0.0, 0.0], along, (0.5, 0.0, 0.0), bits=bits, stalled=stalled)
        assert action.tolist() == [share, 0.0, 0.0] if share else float(action[1]) < 0.0
        action = filtered([0.0, 1.0, 0.0], against, (0.5, 0.0, 0.0), bits=bits, stalled=stalled)
        assert 0.02 * float(action[1]) < gap


def test_steps_count_in_which_the_object_stays() -> None:
    contact_filter, tip = ContactFilter(TIP, WORKSPACE.bounds()), (0.5, -0.2, 0.0)
    state, counts = contact_filter._reset(None, scene([0.0] * 3, tip, (0.5, 0.0, 0.0))), []
    for x in (0.5, 0.508, 0.516, 0.516):  # up to 1 cm from where it was first
        state = contact_filter._step(state, scene([0.0] * 3, tip, (x, 0.0, 0.0)))
        counts.append(float(state["stalled"][0, 2]))
    assert counts == [1.0, 2.0, 0.0, 1.0]
    assert state["stalled"][0, :2].tolist() == pytest.approx([0.516, 0.0])


def test_the_object_is_not_pushed_over_the_edge_but_back() -> None:
    x = 0.75 + 0.05 - 0.02  # where an episode ends, less 2 cm
    over = filtered([1.0, 0.0, 0.0], (x - 0.036, 0.0, math.pi / 2), (x, 0.0, math.pi / 2))
    assert float(over[0]) < 0.5
    back = filtered([-1.0, 0.0, 0.0], (x + 0.036, 0.0, math.pi / 2), (x, 0.0, math.pi / 2))
    assert back.tolist() == [-1.0, 0.0, 0.0]


def test_an_object_near_the_edge_is_pushed_along_it_and_no_further() -> None:
    thing, x = (0.79, 0.0, math.pi / 2), 0.79  # 1 cm before the end of an episode
    along = filtered([0.0, 1.0, 0.0], (x, -0.062, 0.0), thing)
    assert along.tolist() == [0.0, 1.0, 0.0]
    push, behind = [0.25, 0.0, 0.0], (x - 0.036, 0.0, math.pi / 2)
    assert float(filtered(push, behind, thing)[0]) <= 0.0
    stalled = [x, 0.0, 60.0]
    assert filtered(push, behind, thing, stalled=stalled).tolist() == push
    assert 0.02 * float(filtered([1.0, 0.0, 0.0], behind, thing, stalled=stalled)[0]) < 0.01


def test_a_tool_in_contact_may_leave() -> None:
    bits = blocked((0.5, 0.04))  # the tool's side touches it
    action = filtered([0.0, -1.0, 0.0], (0.5, 0.004, 0.0), bits=bits)
    assert float(action[1]) < -0.5


def test_an_obstacle_that_comes_near_counts_where_it_will_be() -> None:
    bits, tip = blocked((0.5, 0.1)), (0.5, 0.045, 0.0)  # 19 mm apart
    still = filtered([0.0, 0.0, 0.0], tip, bits=bits)
    assert not still.any()
    comes = filtered([0.0, 0.0, 0.0], tip, bits=bits, obstacle_motion=[0.5, 0.1, 0.0, -0.2])
    assert float(comes[1]) < 0.0


def test_the_object_is_pushed_out_of_the_way_when_there_is_no_more_time() -> None:
    """The obstacle comes from +y, 15 cm a second; the tool is beside the box, which it can push to +x."""
    tip, thing = (0.45 - 0.037, 0.0, math.pi / 2), (0.45, 0.0, math.pi / 2)
    rest = [0.0, 0.0, 0.0]
    for y, speed, is_pushed in [(0.2, -0.15, False), (0.13, -0.15, True), (0.13, 0.15, False)]:
        motion = [0.42, y, 0.0, speed]
        action = filtered(rest, tip, thing, bits=blocked((0.42, y)), obstacle_motion=motion)
        assert (float(action[0]) > 0.5) == is_pushed
        assert is_pushed or not action.any()


def test_an_obstacle_is_expected_to_turn_round_where_its_area_ends() -> None:
    """It has passed the box, and comes back before the tool would have to begin to push."""
    tip, thing = (0.45 - 0.037, 0.1, math.pi / 2), (0.45, 0.1, math.pi / 2)
    state = scene(
        [0.0, 0.0, 0.0],
        tip,
        thing,
        bits=blocked((0.42, 0.22)),
        obstacle_motion=[0.42, 0.22, 0.0, 0.15],
    )
    for y1, is_pushed in [(0.23, True), (0.35, False)]:
        area = Rectangle((0.2, -0.35), (0.75, y1))
        contact_filter = ContactFilter(TIP, WORKSPACE.bounds(), patrol_area=area)
        action = contact_filter.filter(state, state["action"])[0]
        assert (float(action[0]) > 0.5) == is_pushed


def test_the_object_is_not_pushed_into_the_way_of_an_obstacle_that_comes() -> None:
    """The box stands 3 cm beside the obstacle's way, on the other side of the tool."""
    tip, thing = (0.475 + 0.037, 0.0, math.pi / 2), (0.475, 0.0, math.pi / 2)
    bits, push = blocked((0.42, 0.14)), [-1.0, 0.0, 0.0]
    assert filtered(push, tip, thing, bits=bits).tolist() == push
    action = filtered(push, tip, thing, bits=bits, obstacle_motion=[0.42, 0.14, 0.0, -0.15])
    assert float(action[0]) > -0.1


def test_a_way_out_that_has_been_begun_is_there_in_the_next_step() -> None:
    """Otherwise the tool goes to and fro between ways: with directions that turn with it, in 1 of 5."""
    rng, contact_filter, begun = np.random.default_rng(0), ContactFilter(TIP, WORKSPACE.bounds()), 0
    for _ in range(80):
        around, away, yaw, y = rng.uniform((-3.1, 0.07, -3.1, 0.12), (3.1, 0.13, 3.1, 0.3))
        tip = (0.45 + away * math.cos(around), away * math.sin(around), 0.0)
        bits, motion = blocked((0.42, y)), [0.42, y, 0.0, -0.1]
        still = scene([0.0] * 3, tip, (0.45, 0.0, yaw), bits=bits, obstacle_motion=motion)
        (pushed,) = contact_filter.scenes(still)
        pose, speed, inside = start(pushed)
        before, dx, dy = escape(pushed, (pose, speed, tip, inside), 0, 0.005, False)
        if not 1.0 < before < math.inf:
            continue
        for part in range(1, PARTS + 1):
            there = tip_at(pushed, np.array([dx, dy, 0.0]), part / PARTS)
            pose, speed, _ = object_after(pushed, pose, speed, there, inside)
        after = escape(pushed, (pose, speed, there, inside), 1, 0.005, False)[0]
        assert after <= before - 1.0
        begun += 1
    assert begun > 50


def test_an_object_that_slides_on_counts_where_it_stops() -> None:
    """A push at full speed ends beside the obstacle's way, and 9 mm further the box is in it."""
    bits, motion, push = blocked((0.42, 0.14)), [0.42, 0.14, 0.0, -0.15], [-1.0, 0.0, 0.0]
    for x, is_allowed in [(0.5, False), (0.51, True)]:
        tip, thing = (x + 0.037, 0.0, math.pi / 2), (x, 0.0, math.pi / 2)
        pushed = {"previous_object_pose": [x + 0.02, 0.0, math.pi / 2], "obstacle_motion": motion}
        action = filtered(push, tip, thing, bits=bits, **pushed)
        assert action.tolist() == (push if is_allowed else [0.0, 0.0, 0.0])


def test_what_stands_is_kept_and_what_moves_is_not() -> None:
    contact_filter = ContactFilter(TIP, WORKSPACE.bounds())
    tip, thing = (0.45 - 0.037, 0.0, math.pi / 2), (0.45, 0.0, math.pi / 2)
    for y in (0.3, 0.2, 0.13):
        bits, motion = blocked((0.42, y), (0.6, 0.2)), [0.42, y, 0.0, -0.15]
        state = scene([0.0, 0.0, 0.0], tip, thing, bits=bits, obstacle_motion=motion)
        fresh = ContactFilter(TIP, WORKSPACE.bounds())
        (seen,), (expected,) = contact_filter.scenes(state), fresh.scenes(state)
        np.testing.assert_array_equal(seen.distances, expected.distances)
        np.testing.assert_array_equal(seen.moving, expected.moving)
        assert seen.distances is contact_filter.scenes(state)[0].distances


@pytest.mark.parametrize("contact_filter", [False, True])
def test_a_box_on_the_table_is_kept_from_an_obstacle_that_comes(contact_filter) -> None:
    """An agent stands still for 8 s of real physics, in which the bar comes in all four episodes."""
    config = load_agent("pose").config
    env = make_push_env(
        config,
        num_envs=4,
        encoder="none",
        entries=("ee_position",),
        add=(),
        contact_filter=contact_filter,
    )
    episodes = generate_set("pose/moving_bar/box", (5005, 5008, 5009, 5010))
    state = env.reset(scenarios=list(episodes.scenarios))
    struck = torch.zeros(4, 1, dtype=torch.bool)
    for _ in range(120):
        state = env.step(state.set("action", torch.zeros(4, 3)))
        struck |= state["next", "obstacle_contact"] | state["next", "tool_obstacle_contact"]
        state = step_mdp(state)
        assert not state["out_of_bounds"].any() or not contact_filter
    env.close()
    assert int(struck.sum()) == (0 if contact_filter else 4)


def test_only_the_obstacle_that_moves_is_looked_ahead() -> None:
    """Another one, on the other side of the box, stands."""
    tip, thing = (0.45 - 0.037, 0.0, math.pi / 2), (0.45, 0.0, math.pi / 2)
    bits, rest = blocked((0.42, 0.3), (0.42, -0.11)), [0.0, 0.0, 0.0]
    assert not filtered(rest, tip, thing, bits=bits, obstacle_motion=[0.42, 0.3, 0.0, 0.15]).any()


def test_the_outline_of_a_box_has_its_corners_and_no_gaps() -> None:
    points = outline(BOX.double().numpy())
    np.testing.assert_allclose(np.abs(points).max(0), [0.05, 0.025], atol=1e-6)
    sides = np.abs(points) - [0.05, 0.025]
    np.testing.assert_allclose(sides.max(1), 0.0, atol=1e-6)
    assert np.isclose(sides, 0.0, atol=1e-6).all(1).sum() == 4
    assert np.linalg.norm(points - np.roll(points, 1, axis=0), axis=1).max() <= 0.008


def test_a_map_that_changes_is_read_again_and_the_filter_can_be_pickled() -> None:
    contact_filter = pickle.loads(pickle.dumps(ContactFilter(TIP, WORKSPACE.bounds())))
    state = scene([0.0, 1.0, 0.0], (0.5, 0.05, 0.0))
    assert contact_filter.filter(state, state["action"])[0, 1] == 1.0
    state["blocked_bits"] = blocked((0.5, 0.1))
    assert contact_filter.filter(state, state["action"])[0, 1] < 1.0


def test_in_a_stack_the_agents_own_action_is_stored() -> None:
    env = make_push_env(
        num_envs=2,
        scene="two_rectangles",
        frame="path",
        action_frame=None,
        encoder="none",
        contact_filter=True,
        seed=0,
    )
    check_env_specs(env)
    state = env.reset()
    action = torch.tensor([[1.0, 0.0, 0.0], [-1.0, 0.5, 0.3]])
    for _ in range(3):
        state = env.step(state.set("action", action.clone()))
        assert torch.equal(state["action"], action)
        state = step_mdp(state)
    env.close()


def test_a_missing_key_is_named() -> None:
    with pytest.raises(KeyError, match="blocked_bits"):
        ContactFilter(TIP, WORKSPACE.bounds()).inv(
            scene([0.0, 0.0, 0.0], (0.5, 0.0, 0.0)).exclude("blocked_bits")
        )


def test_numbers_out_of_range_are_refused() -> None:
    with pytest.raises(ValueError, match="clearance"):
        ContactFilter(TIP, WORKSPACE.bounds(), clearance=-0.1)
