from dataclasses import replace

import numpy as np
import pytest
import torch
from tensordict import TensorDict
from torchrl.envs import set_exploration_type
from torchrl.envs.utils import ExplorationType, step_mdp

from modpush import load_agent
from modpush.deploy import PushController, Stopped, load_policy
from modpush.deploy.source_env import SourceEnv
from modpush.evaluation import load_set
from modpush.export import export_agent
from modpush.geometry.camera import CAMERA, Label
from modpush.training.scene_worker import FirstActions
from tests.deploy.conftest import Rig, straight_push


def step(rig: Rig):
    """One control step without the guard."""
    command = rig.controller.act(rig.read_depth().depth, rig.arm.observe().joints)
    rig.arm.command(command)
    return command


def test_it_does_what_the_agent_does_in_its_own_environment(agent) -> None:
    scenario = load_set("obstacles/large_cube").scenarios[1]
    rig = Rig(agent, scenario)
    rig.controller.reset(scenario.goal_position)
    env = agent.make_env(1, engine="mujoco", pushed_object="large_cube", scene="free")
    policy = agent.policy
    with torch.no_grad(), set_exploration_type(ExplorationType.DETERMINISTIC):
        state = env.reset(scenarios=[scenario])
        for _ in range(25):
            state = step_mdp(env.step(policy(state)))
            step(rig)
            ours = rig.controller.perception.arm
            assert ours.object_pose == pytest.approx(state["object_pose"][0].numpy(), abs=3e-3)
            tip = ours.scene.link_transforms(["tip"])[0][:2]
            assert tip == pytest.approx(state["ee_pose"][0, :2].numpy(), abs=3e-3)
    env.close()
    assert np.hypot(*(rig.arm.object_pose - scenario.object_pose)[:2]) > 0.1  # it has pushed


def test_an_exported_folder_gives_the_same_commands(agent, tmp_path) -> None:
    export_agent(agent, tmp_path, ("onnx",))
    ours, theirs = Rig(agent), Rig(load_policy(tmp_path))
    for rig in (ours, theirs):
        rig.controller.reset((0.6, 0.05))
    for _ in range(6):
        one, other = step(ours), step(theirs)
        assert one.target == pytest.approx(other.target, abs=1e-5)


def test_a_folder_without_its_graph_is_refused(agent, tmp_path) -> None:
    export_agent(agent, tmp_path, ("torch_export",))
    with pytest.raises(ValueError, match=r"must hold policy\.onnx beside card\.json"):
        load_policy(tmp_path)
    (tmp_path / "card.json").write_text("{}")
    with pytest.raises(ValueError, match=r"must be a card of `modpush export`"):
        load_policy(tmp_path)


def test_an_episode_does_not_depend_on_the_one_before(agent) -> None:
    rig = Rig(agent)
    courses = []
    for _ in range(2):
        rig.arm.connect()
        rig.controller.reset((0.6, 0.05))
        courses.append([step(rig).target for _ in range(8)])
    assert np.array_equal(*courses)


def test_an_arm_that_does_not_move_is_noticed(rig) -> None:
    rig.controller.reset((0.6, 0.05))
    joints, depth = rig.arm.observe().joints, rig.read_depth().depth
    commands = [rig.controller.act(depth, joints) for _ in range(6)]
    way = [command.target - command.start for command in commands]
    # After four steps at rest the recovery asks for a turn at full speed.
    assert way[4] != pytest.approx(way[3], abs=1e-3)
    assert way[4][2] == pytest.approx(0.05)


def test_a_blocked_arm_does_not_wind_up(rig) -> None:
    rig.controller.reset((0.6, 0.05))
    joints, depth = rig.arm.observe().joints, rig.read_depth().depth
    for _ in range(10):
        command = rig.controller.act(depth, joints)
    tip = rig.controller.perceived.tip_pose
    assert np.hypot(*(command.start[:2] - tip[:2])) <= 0.012 + 1e-9


def test_the_goal_may_move(rig) -> None:
    rig.controller.reset((0.6, 0.05))
    joints, depth = rig.arm.observe().joints, rig.read_depth().depth
    one = rig.controller.act(depth, joints)
    assert not rig.controller.success
    other = rig.controller.act(depth, joints, goal=(0.45, -0.2))
    assert not np.allclose(one.target, other.target, atol=1e-3)
    rig.controller.act(depth, joints, goal=(0.45, 0.04))
    assert rig.controller.success


def test_contact_is_seen_where_there_is_one(rig) -> None:
    rig.controller.reset((0.6, 0.05))
    seen, true = [], []
    for _ in range(25):
        step(rig)
        seen.append(rig.controller.contact)  # in the image before the step
        true.append(rig.arm.contacts[3])  # at the end of the step
    agree = np.array(seen[1:]) == np.array(true[:-1])
    assert any(true)
    assert not all(true)
    assert agree.mean() > 0.8


def test_a_lower_rate_takes_the_same_way_more_slowly(agent) -> None:
    fast, slow = Rig(agent), Rig(agent, rate=5)
    for rig in (fast, slow):
        rig.controller.reset((0.6, 0.05))
        rig.steps = [step(rig) for _ in range(3)]
    assert slow.steps[0].duration == pytest.approx(3 * fast.steps[0].duration)
    assert slow.steps[0].target == pytest.approx(fast.steps[0].target, abs=1e-6)
    assert slow.arm.time == pytest.approx(3 * fast.arm.time)


@pytest.mark.parametrize(
    "change", [lambda p: None, lambda p: p._replace(object=p.object._replace(found=False))]
)
def test_the_first_image_must_show_the_object(rig, change) -> None:
    rig.seen.change = change
    rig.controller.reset((0.6, 0.05))
    with pytest.raises(Stopped, match="put it on the table"):
        step(rig)


def test_wrong_use_is_refused(agent, rig) -> None:
    with pytest.raises(RuntimeError, match="call reset first"):
        PushController(agent, rig.seen).act(rig.read_depth().depth, rig.arm.observe().joints)
    for goal in ((0.5,), (0.5, 0.0, 0.0), (0.5, float("nan"))):
        with pytest.raises(ValueError, match="goal must be 2 finite numbers"):
            rig.controller.reset(goal)
    with pytest.raises(ValueError, match="no agent 'nobody'"):
        PushController("nobody", rig.seen)


@pytest.mark.parametrize("field", ["dynamic_obstacles", "object_dynamics"])
def test_an_agent_that_observes_more_than_is_measured_is_refused(agent, rig, field) -> None:
    config = replace(agent.config, simulation=replace(agent.config.simulation, **{field: True}))
    with pytest.raises(ValueError, match="must not observe where movable obstacles are"):
        PushController(replace(agent, config=config), rig.seen)


@pytest.fixture(scope="module")
def pose_agent():
    return load_agent("pose")


def pose_push(goal_yaw: float):
    return straight_push(
        pushed_object="box",
        object_pose=(0.45, 0.0, 0.4),
        tool_pose=(0.33, 0.0, 0.0),
        goal_yaw=goal_yaw,
    )


@pytest.mark.parametrize("goal_yaw", [0.9, 0.9 - np.pi])
def test_the_agent_of_goal_poses_turns_the_object(pose_agent, goal_yaw) -> None:
    # Turned by half a turn the box looks the same, so that the nearer of both yaw angles is met.
    scenario = pose_push(goal_yaw)
    rig = Rig(pose_agent, scenario)
    assert rig.push(goal=(*scenario.goal_position, goal_yaw)).success
    x, y, yaw = rig.arm.object_pose
    config = pose_agent.config.simulation
    assert np.hypot(x - 0.60, y - 0.05) <= config.position_tolerance
    assert abs((yaw - 0.9 + np.pi / 2) % np.pi - np.pi / 2) <= config.yaw_tolerance
    assert abs(yaw - 0.9) < 0.5  # not turned over


def test_it_observes_goal_poses_as_the_environment_does(pose_agent) -> None:
    scenario = pose_push(0.9)
    rig = Rig(pose_agent, scenario)
    rig.controller.reset((*scenario.goal_position, 0.9))
    env = pose_agent.make_env(1, engine="mujoco", scene="free")
    state = env.reset(scenarios=[scenario])
    step(rig)
    ours = rig.controller._state
    assert not ours["obstacle_motion"].any()
    keys = ("pose_error", "goal_pose", "object_symmetry", "obstacle_motion", "tool_half_extents")
    for key in (*keys, "observation"):
        assert ours[key].numpy() == pytest.approx(state[key].numpy(), abs=2e-3), key
    env.close()


def test_a_goal_pose_is_reached_only_with_its_yaw(pose_agent) -> None:
    rig = Rig(pose_agent, pose_push(0.4))
    for yaw, reached in ((0.4, True), (0.4 + np.pi, True), (0.4 + np.radians(9), False)):
        rig.controller.reset((0.45, 0.0, yaw))
        rig.controller.act(rig.read_depth().depth, rig.arm.observe().joints)
        assert rig.controller.success == reached


def test_steps_are_shortened_where_a_joint_would_be_too_fast(agent) -> None:
    def fastest(rig: Rig) -> float:
        rig.controller.reset((0.6, 0.05))
        speeds = []
        for _ in range(12):
            joints = rig.arm.observe().joints
            speeds.append(np.abs(step(rig).joints - joints).max() * rig.controller.rate)
        return max(speeds)

    assert fastest(Rig(agent)) > 0.5
    assert fastest(Rig(agent, joint_speed=0.4)) <= 0.4


def test_the_source_has_the_keys_of_the_environment(agent, rig) -> None:
    rig.controller.reset((0.6, 0.05))
    step(rig)
    arm, config = rig.arm, agent.config
    parts = (arm.item, arm.robot, arm.tool, arm.item.tool_height)
    source = SourceEnv(*parts, config.scenario, config.simulation)
    source.entries = rig.controller._source.entries
    env = agent.make_env(1, engine="mujoco", scene="free", keep_images=True)
    theirs = env.base_env.reset()
    assert set(theirs.keys()) == set(source.reset().keys())
    for key, value in source.rand_step(TensorDict(batch_size=[1]))["next"].items():
        if key != "reward":
            assert (value.shape, value.dtype) == (theirs[key].shape, theirs[key].dtype), key
    env.close()


def test_obstacles_in_the_image_say_how_wide_the_tool_is(rig) -> None:
    rig.controller.reset((0.6, 0.05))
    step(rig)
    seen, source = rig.controller.perceived, rig.controller._source
    for height, expected in (
        (0.0, (0.032, 0.011)),
        (0.06, (0.032, 0.011)),
        (0.09, (0.062, 0.0135)),
    ):
        depth, segmentation = seen.depth.copy(), seen.segmentation.copy()
        if height:
            depth[:20, :20], segmentation[:20, :20] = CAMERA.z - height, Label.OBSTACLE
        there = seen._replace(depth=depth, segmentation=segmentation)
        source.show(there, rig.arm.observe().joints, (0.6, 0.05), False, (0.05, 0.1))
        assert source.entries["tool_half_extents"][0].tolist() == pytest.approx(expected)


def test_an_object_at_its_goal_is_not_pushed(rig) -> None:
    assert rig.push(goal=(0.46, 0.0)) == (True, 0)


def test_the_tool_steps_aside_after_half_a_second_of_unseen_contact(rig) -> None:
    unseen = 0

    def hidden_from_the_sixth_image(perceived):
        nonlocal unseen
        unseen += 1
        estimate = perceived.object._replace(found=unseen < 6, unseen_for=max(0, unseen - 5))
        return perceived._replace(object=estimate)

    def distance() -> float:
        step(rig)
        return np.hypot(*np.subtract(rig.controller.perceived.tip_pose, rig.arm.object_pose)[:2])

    rig.seen.change = hidden_from_the_sixth_image
    rig.controller.reset((0.6, 0.05))
    away = np.array([distance() for _ in range(20)])
    left = 10 + np.flatnonzero(away[10:] > away[10] + 0.01)[0]
    assert 12 <= left <= 16  # 8 images from the sixth on, in which it pushes, and a step
    assert away[10:].max() > away[10] + 0.06
    rig.seen.change = lambda perceived: perceived
    assert min(distance() for _ in range(14)) < away[10] + 0.01  # and it returns


def test_the_goal_is_reached_only_by_an_image_that_shows_the_object(rig) -> None:
    rig.controller.reset((0.6, 0.05))
    for _ in range(6):
        step(rig)
    rig.controller.goal = tuple(rig.arm.object_pose[:2])
    rig.seen.change = lambda seen: seen._replace(object=seen.object._replace(found=False))
    near = np.hypot(*np.subtract(rig.controller.perceived.tip_pose, rig.arm.object_pose)[:2])
    for _ in range(4):  # the tool makes way at once
        step(rig)
        assert not rig.controller.success
    away = np.hypot(*np.subtract(rig.controller.perceived.tip_pose, rig.arm.object_pose)[:2])
    assert away > near + 0.02
    rig.seen.change = lambda seen: seen
    step(rig)
    assert rig.controller.success


def test_a_push_passes_the_guess_of_the_start_on(rig, monkeypatch) -> None:
    given, reset = [], rig.seen.reset

    def noted(guess=None) -> None:
        given.append(guess)
        reset(guess)

    monkeypatch.setattr(rig.seen, "reset", noted)
    assert rig.push(guess=(0.45, 0.0, 0.1)).success
    assert given == [(0.45, 0.0, 0.1)]


def test_an_agent_s_memory_is_kept_between_images(agent) -> None:
    config = replace(agent.config, add=(*agent.config.add, "history"), recovery=False)
    pusher = replace(agent, actor=FirstActions(config), config=config, fingerprint={})
    rig = Rig(pusher)
    rig.controller.reset((0.6, 0.05))
    torch.manual_seed(0)
    remembered = []
    for _ in range(20):
        step(rig)
        remembered.append(int(rig.controller._state["history"].any(-1).sum()))
    assert remembered[0] == 0
    assert remembered == sorted(remembered)
    assert remembered[-1] > 3
    rig.controller.reset((0.6, 0.05))
    step(rig)
    assert not rig.controller._state["history"].any()
