"""What the agent sees."""

import math
from dataclasses import replace

import pytest
import torch
from tensordict import TensorDict
from torchrl.data import LazyTensorStorage, ReplayBuffer
from torchrl.envs import Compose, TransformedEnv, check_env_specs

from modpush.envs import PushEnv
from modpush.envs.scenes.objects import OBJECTS
from modpush.envs.scenes.scenario import Dynamics
from modpush.geometry.frames import rotate
from modpush.mdp import ENTRIES, PAPER_ENTRIES, ActionFrame, Entry, ObservationKeys, PushObservation
from tests.envs.engines.sapien.test_agent import scenario
from tests.mdp.straight_path import StraightPath


def make_state(batch=2, seed=0):
    g = torch.Generator().manual_seed(seed)

    def draw(*shape):
        return torch.rand(batch, *shape, generator=g) - 0.5

    return TensorDict(
        {
            "object_pose": draw(3),
            "goal_position": draw(2),
            "ee_pose": draw(3),
            "joint_position": draw(6),
            "object_radius": draw(1).abs(),
            "object_symmetry": torch.full((batch, 1), 4.0),
            "object_support": draw(48).abs(),
            "object_contact": draw(1) > 0,
            "path_length": draw(1).abs(),
            "subgoal": draw(2),
            "subgoal_past": draw(2, 2),
            "path_ahead": draw(3, 2),
            "latent": draw(32),
            "last_action": draw(3),
            "goal_pose": draw(3),
            "pose_error": draw(2),
            "obstacle_motion": draw(4),
            "object_dynamics": draw(4).abs() + 0.1,
            "history": draw(8, 10),
            "subgoal_pose": draw(3),
            "pose_path_ahead": draw(3, 3),
            "pose_path_length": draw(1).abs(),
        },
        [batch],
    )


def moved(state, angle, shift):
    """The whole scene turned and shifted; joints and latent are not asked to follow."""
    state = state.clone()
    turn = torch.full((len(state), 1), angle)
    for key in ("goal_position", "subgoal"):
        state[key] = rotate(state[key], turn) + shift
    for key in ("subgoal_past", "path_ahead"):
        state[key] = rotate(state[key], turn.unsqueeze(-2)) + shift
    place, velocity = state["obstacle_motion"].split(2, -1)
    state["obstacle_motion"] = torch.cat([rotate(place, turn) + shift, rotate(velocity, turn)], -1)
    for key in ("object_pose", "ee_pose", "goal_pose", "subgoal_pose", "pose_path_ahead"):
        turns = turn.unsqueeze(-2) if state[key].ndim == 3 else turn
        position = rotate(state[key][..., :2], turns) + shift
        state[key] = torch.cat([position, state[key][..., 2:] + angle], -1)
    return state


def test_the_papers_observation_has_49_values_in_its_order():
    state = make_state()
    seen = PushObservation("object", raw=True)(state)["observation"]
    assert seen.shape == (2, 49)
    assert torch.equal(seen[:, :32], state["latent"])
    assert (seen[:, 35:37] == 0).all()  # pitch and roll of a tool that points down
    assert torch.equal(seen[:, 37:43], state["joint_position"])
    assert torch.equal(seen[:, 47:48], state["object_contact"].float())
    apart = (state["goal_position"] - state["object_pose"][:, :2]).norm(dim=-1)
    torch.testing.assert_close(seen[:, 48], apart)


def test_values_by_hand_in_the_objects_frame():
    state = make_state(1)
    state["object_pose"] = torch.tensor([[0.5, 0.1, math.pi / 2]])
    state["ee_pose"] = torch.tensor(
        [[0.5, 0.0, 0.0]]
    )  # 0.1 m behind along -y: x = -0.1 in the frame
    state["subgoal_past"] = torch.tensor([[[0.4, 0.1], [0.5, 0.3]]])
    seen = PushObservation("object", entries=["ee_pose", "subgoal_past"], raw=True)(state)
    torch.testing.assert_close(
        seen["observation"],
        torch.tensor([[-0.1, 0.0, -math.pi / 2, 0.0, 0.0, 0.0, 0.1, 0.2, 0.0]]),
        atol=1e-6,
        rtol=0,
    )


def test_in_the_path_frame_the_subgoal_lies_straight_ahead():
    state = make_state(5)
    seen = PushObservation("path", entries=["subgoal"], raw=True)(state)["observation"]
    torch.testing.assert_close(seen[:, 1], torch.zeros(5), atol=1e-6, rtol=0)
    assert (seen[:, 0] > 0).all()


@pytest.mark.parametrize("frame", ["object", "path"])
def test_turning_and_shifting_the_whole_scene_changes_nothing(frame):
    state = make_state(8)
    entries = [name for name in ENTRIES if name != "edges"]  # the workspace stays where it is
    observe = PushObservation(frame, entries=entries)
    before = observe(state.clone())["observation"]
    after = observe(moved(state, 1.1, torch.tensor([0.2, -0.3])))["observation"]
    torch.testing.assert_close(after, before, atol=2e-5, rtol=1e-4)


def test_a_cube_turned_by_a_quarter_looks_the_same():
    state = make_state(4)
    observe = PushObservation("path", entries=["object_axis"])
    before = observe(state.clone())["observation"]
    state["object_pose"][:, 2] += math.pi / 2
    torch.testing.assert_close(observe(state)["observation"], before, atol=1e-5, rtol=0)


def test_the_closed_gripper_looks_the_same_from_both_sides():
    state = make_state(1)
    state["object_pose"] = torch.tensor([[0.5, 0.1, 0.3]])
    observe = PushObservation("object", entries=["ee_axis"], raw=True)
    seen = []
    for yaw in (0.3, 0.3 + math.pi, 0.3 + math.pi / 4, 0.3 + math.pi / 2):
        state["ee_pose"] = torch.tensor([[0.5, 0.0, yaw]])
        seen.append(observe(state.clone())["observation"][0])
    # Cosine and sine of twice the yaw in the object's frame: of 0, 360, 90 and 180 degrees.
    expected = torch.tensor([[1.0, 0.0], [1.0, 0.0], [0.0, 1.0], [-1.0, 0.0]])
    torch.testing.assert_close(torch.stack(seen), expected, atol=1e-6, rtol=0)


def test_how_far_an_object_reaches_turns_with_it():
    """An oblong of 8 x 5 cm: 4 cm along its own x, 2.5 cm across, seen in the base frame."""
    state = make_state(3)
    state["object_support"] = torch.from_numpy(OBJECTS["large_cube"].support).float().expand(3, -1)
    state["object_pose"][:, 2] = torch.tensor([0.0, math.pi / 2, math.pi / 4 + 0.01])
    seen = PushObservation("base", entries=["object_support"], raw=True)(state)["observation"]
    assert seen.shape == (3, 8)
    torch.testing.assert_close(seen[0, ::2], torch.tensor([0.04, 0.025, 0.04, 0.025]))
    torch.testing.assert_close(
        seen[1, ::2], torch.tensor([0.025, 0.04, 0.025, 0.04]), atol=1e-6, rtol=0
    )
    corners = OBJECTS["large_cube"].footprints()[0]
    yaw = math.pi / 4 + 0.01
    for k in range(8):
        direction = math.cos(k * math.pi / 4 - yaw), math.sin(k * math.pi / 4 - yaw)
        # Between two of the 48 directions it is interpolated.
        assert seen[2, k].item() == pytest.approx((corners @ direction).max(), abs=2e-4)


def test_a_disc_has_no_axis_to_see():
    state = make_state(3)
    state["object_symmetry"] = torch.tensor([[0.0], [0.0], [1.0]])
    seen = PushObservation("path", entries=["object_axis"])(state)["observation"]
    disc = torch.tensor([1.0, 0.0])
    assert torch.equal(seen[:2], disc.expand(2, 2))
    assert not torch.equal(seen[2], disc)  # beside them, an object of another symmetry


def test_edges_of_the_workspace_by_hand():
    # Episodes end outside x 0.15 to 0.80, y -0.40 to 0.40.
    state = make_state(3)
    state["object_pose"] = torch.tensor([[0.20, 0.0, 0.0], [0.75, -0.39, 0.0], [0.5, 0.0, 0.0]])
    state["subgoal"] = state["object_pose"][:, :2] + torch.tensor([0.0, 0.1])  # ahead is +y
    seen = PushObservation("path", entries=["edges"], raw=True)(state.clone())["observation"]
    near = torch.tensor([[0.0, 0.10, 0.0, 0.0], [0.0, 0.0, 0.14, 0.10], [0.0, 0.0, 0.0, 0.0]])
    torch.testing.assert_close(seen, near, atol=1e-5, rtol=0)  # ahead, left, behind, right
    seen = PushObservation("path", entries=["edges"])(state)["observation"]
    torch.testing.assert_close(seen, near / 0.15, atol=1e-4, rtol=0)


def test_the_edge_is_where_the_line_ahead_meets_it():
    state = make_state(400, seed=3)
    spread = torch.tensor([0.6, 0.75, 1.0])
    state["object_pose"] = state["object_pose"] * spread + torch.tensor([0.475, 0.0, 0.0])
    seen = PushObservation("path", entries=["edges"], raw=True)(state)["observation"]
    position, way = state["object_pose"][:, :2], state["subgoal"] - state["object_pose"][:, :2]
    for side, turn in enumerate((0.0, math.pi / 2, math.pi, -math.pi / 2)):
        ray = rotate(way / way.norm(dim=-1, keepdim=True), torch.full((400, 1), turn))
        steps = torch.linspace(0, 0.15, 1501)
        at = position[:, None] + ray[:, None] * steps[:, None]
        inside = ((at > torch.tensor([0.15, -0.40])) & (at < torch.tensor([0.80, 0.40]))).all(-1)
        walked = inside.int().cumprod(1).sum(1) * 1e-4
        torch.testing.assert_close(seen[:, side], 0.15 - walked.clamp(0, 0.15), atol=3e-4, rtol=0)
    assert (seen > 0).float().mean() > 0.1


def test_a_given_symmetry_counts_for_every_object():
    state = make_state()
    state["object_symmetry"] = torch.tensor([[1.0], [0.0]])
    own = PushObservation("path", entries=["object_axis", "object_symmetry"], raw=True)
    given = PushObservation(
        "path", entries=["object_axis", "object_symmetry"], symmetry=4, raw=True
    )
    cube = state.clone().set("object_symmetry", torch.full((2, 1), 4.0))
    assert torch.equal(given(state.clone())["observation"], own(cube)["observation"])
    assert own(state)["observation"][:, 2].tolist() == [1.0, 0.0]


def test_scaled_values_are_the_raw_ones_shifted_and_scaled():
    state = make_state()
    scaled = PushObservation("object")(state.clone())["observation"]
    raw = PushObservation("object", raw=True)(state)["observation"]
    at = 0
    for name in PAPER_ENTRIES:
        entry = ENTRIES[name]
        n = {"latent": 32, "ee_pose": 5, "joint_position": 6, "subgoal_past": 4}.get(name, 1)
        part = (raw[:, at : at + n] - torch.tensor(entry.shift)) * torch.tensor(entry.scale)
        torch.testing.assert_close(scaled[:, at : at + n], part)
        at += n
    assert at == 49


def test_an_entry_of_your_own_may_read_any_key():
    state = make_state()
    state["group"] = TensorDict({"load": torch.tensor([[1.0, 2.0], [3.0, 4.0]])}, [2])
    load = Entry(lambda inputs: inputs["group", "load"], scale=(2.0, 10.0), shift=(1.0, 0.0))
    observe = PushObservation(entries=["contact", ("load", load)])
    seen = observe(state)["observation"]
    assert torch.equal(seen[:, 1:], torch.tensor([[0.0, 20.0], [4.0, 40.0]]))
    assert observe.in_keys == ["object_contact", ("group", "load")]
    assert observe.columns == {"contact": slice(0, 1), "load": slice(1, 3)}


def test_nested_keys():
    state = make_state()
    names = [name for name in state.keys() if name != "last_action"]
    deep = TensorDict({"deep": state.select(*names), "past": state.select("last_action")}, [2])
    keys = {name: ("deep", name) for name in names}
    entries = list(ENTRIES)
    observe = PushObservation(
        entries=entries,
        keys=ObservationKeys(last_action=("past", "last_action"), **keys),
        observation_key=("deep", "o"),
    )
    expected = PushObservation(entries=entries)(state.clone())["observation"]
    assert torch.equal(observe(deep)["deep", "o"], expected)
    assert set(observe.in_keys) == {*keys.values(), ("past", "last_action")}


def test_a_missing_key_is_named():
    with pytest.raises(KeyError, match="key 'subgoal_past' is missing"):
        PushObservation()(make_state().exclude("subgoal_past"))
    env = TransformedEnv(PushEnv(1, depth=None), PushObservation(entries=["path_length"]))
    with pytest.raises(KeyError, match="key 'path_length' is missing"):
        _ = env.observation_spec
    env.close()


def test_an_entry_of_a_wrong_shape_is_named():
    flat = ("flat", lambda inputs: inputs.contact[..., 0])
    with pytest.raises(ValueError, match=r"entry 'flat' must be \[..., n\] .* \[2\], got \[2\]"):
        PushObservation(entries=["goal", flat])(make_state())
    unequal = ("unequal", Entry(lambda inputs: inputs.goal, scale=(1.0, 2.0, 3.0)))
    with pytest.raises(ValueError, match="scale of 'unequal' must be one number or 2"):
        PushObservation(entries=[unequal])(make_state())
    unequal = ("unequal", Entry(lambda inputs: inputs.goal, shift=(1.0,)))
    with pytest.raises(ValueError, match="shift of 'unequal' must be one number or 2"):
        PushObservation(entries=[unequal])(make_state())


def test_stored_data_are_rewritten_at_the_root_and_in_next():
    buffer = ReplayBuffer(
        storage=LazyTensorStorage(8), batch_size=4, transform=PushObservation("path")
    )
    stored = make_state(8).set("observation", torch.zeros(8, 54))
    stored["next"] = make_state(8, seed=1).set("observation", torch.zeros(8, 54))
    buffer.extend(stored)
    sample = buffer.sample()
    for part in (sample, sample["next"]):
        expected = PushObservation("path")(part.exclude("next"))["observation"]
        assert torch.equal(part["observation"], expected)
        assert expected.abs().sum() > 0


def test_the_last_action_is_the_agents_and_zero_after_a_reset():
    stack = Compose(
        StraightPath(),
        ActionFrame("path"),
        PushObservation("path", entries=["last_action", "goal"]),
    )
    env = TransformedEnv(PushEnv(2, depth=None, seed=0), stack)
    check_env_specs(env)
    td = env.reset()
    assert torch.equal(td["observation"][:, :3], torch.zeros(2, 3))
    action = torch.tensor([[0.5, -0.3, 0.1], [0.2, 0.8, -0.6]])
    td = env.step(td.set("action", action))
    assert torch.equal(td["next", "observation"][:, :3], action)
    assert torch.equal(td["next", "last_action"], action)
    following = td["next"].clone().set("_reset", torch.tensor([[True], [False]]))
    again = env.reset(following)["observation"][:, :3]
    assert torch.equal(again, torch.stack([torch.zeros(3), action[1]]))
    env.close()


def test_hidden_dynamics_are_told_in_the_agent_s_frame():
    dynamics = Dynamics(mass=4.0, friction=0.1, center_of_mass=(0.01, 0.0))
    start = replace(scenario((0.35, 0.0, 0.0), (0.45, 0.2, math.pi / 2)), dynamics=dynamics)
    env = PushEnv(1, object_dynamics=True, depth=None)
    td = env.reset(scenarios=[start])
    assert td["object_dynamics"].tolist() == [pytest.approx([4.0, 0.1, 0.01, 0.0])]
    for frame, center in (("object", (0.01, 0.0)), ("base", (0.0, 0.01))):
        seen = PushObservation(frame, entries=["object_dynamics"], raw=True)(td)["observation"]
        assert seen.tolist() == [pytest.approx([2.0, 0.1, *center], abs=1e-6)]
    env.close()
