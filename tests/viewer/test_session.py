"""The session runs without a browser, on the real simulator."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest

from modpush.envs import Obstacle
from modpush.envs.scenes.objects import get_object
from modpush.viewer import Page, PlayConfig, Session
from modpush.viewer.lane_view import _flat, _hit_obstacles


@pytest.fixture(scope="module")
def shared() -> Iterator[Session]:
    session = Session(PlayConfig(policy=("agent",)))
    yield session
    session.close()


@pytest.fixture
def session(shared: Session) -> Session:
    """The shipped agent at the beginning of episode 0 of the slot."""
    shared.config = PlayConfig()
    shared.set_paused(False)
    shared.set_auto_continue(False)
    shared.choose_policies("agent")
    shared.choose_scene("slot", 0.3, "small_cube")
    shared.reset(0)
    shared.message = ""
    return shared


def run(session: Session, ticks: int = 150) -> None:
    for _ in range(ticks):
        session.tick()
        if session.ended:
            return


def test_the_agent_reaches_the_goal_and_then_time_stands_still(session) -> None:
    run(session)
    shown = session.snapshots[0]
    assert session.ended
    assert shown.flags["success"]
    session.tick()
    assert session.snapshots[0] is shown


def test_a_moving_obstacle_continues_from_where_it_is_when_the_scene_is_changed(session) -> None:
    session.choose_scene("moving_bar", 0.5)
    start = session.snapshots[0].scenario.obstacles[0]
    run(session, 9)
    np.testing.assert_allclose(
        session.snapshots[0].present.obstacles[0].at(0.0), start.at(0.6), atol=1e-9
    )
    session.move_goal(*session.snapshots[0].scenario.goal_position)
    run(session, 6)
    shown = session.snapshots[0]
    assert shown.step == 6
    np.testing.assert_allclose(shown.present.obstacles[0].at(0.0), start.at(1.0), atol=1e-9)
    simulated = session.lanes[0].env.base_env._batch.obstacle_transforms_of(0)[0, :2]
    np.testing.assert_allclose(simulated, start.at(1.0)[:2], atol=1e-6)
    ends = start.ends()
    x, _ = ends[0]
    session.move_obstacle(0, x + 0.02, 0.5)  # beyond its end
    moved = session.snapshots[0].scenario.obstacles[0]
    assert moved.pose[:2] == pytest.approx((x + 0.02, 0.35), abs=1e-6)
    assert sorted(moved.ends()[:, 1]) == pytest.approx(sorted(ends[:, 1]), abs=1e-6)


def test_a_session_runs_in_another_engine() -> None:
    session = Session(PlayConfig(policy=("agent", "scripted"), engine="mujoco"))
    run(session, 5)
    assert [lane.env.engine_name for lane in session.lanes] == ["mujoco"] * 2
    assert not session.message
    session.close()


@pytest.mark.parametrize("engine", ["sapien", "mujoco"])
def test_a_session_runs_with_another_arm_and_tool(engine) -> None:
    config = PlayConfig(policy=("agent", "scripted"), robot="panda", tool="rod", engine=engine)
    session = Session(config)
    run(session, 5)
    assert not session.message
    for lane, shown in zip(session.lanes, session.snapshots, strict=True):
        assert lane.env.base_env.engine_name == engine
        assert (shown.robot.name, shown.tool.name) == ("panda", "rod")
        flange = shown.robot.link_transforms(shown.joint_position)[-1]
        tip = flange @ [0.0, 0.0, shown.tool.length, 1.0]
        assert tip[:2] == pytest.approx(shown.ee_pose[:2], abs=1e-5)
    session.close()


def test_a_goal_that_is_moved_is_reached_from_where_the_object_is(session) -> None:
    for _ in range(10):
        session.tick()
    before = session.snapshots[0]
    session.submit(lambda: session.move_goal(0.35, -0.2))
    session.paused = True
    session.tick()
    now = session.snapshots[0]
    assert now.object_pose == pytest.approx(before.object_pose, abs=1e-5)
    assert now.ee_pose == pytest.approx(before.ee_pose, abs=1e-5)
    assert now.scenario.goal_position == (0.35, -0.2)
    session.paused = False
    run(session)
    assert session.snapshots[0].flags["success"]


def test_the_planner_s_map_follows_an_obstacle_that_is_moved(session) -> None:
    session.tick()
    before = session.snapshots[0].occupancy
    session.move_obstacle(1, 0.7, -0.3, 0.5)
    assert session.snapshots[0].scenario.obstacles[1].pose == (0.7, -0.3, 0.5)
    assert (session.snapshots[0].occupancy != before).any()


def test_a_command_that_fails_says_why_and_changes_nothing(session) -> None:
    session.paused = True
    before = session.snapshots[0]
    x, y, _ = before.object_pose
    session.submit(lambda: session.move_obstacle(0, x, y))
    session.tick()
    assert session.message == "An obstacle cannot stand where the object is."
    assert session.snapshots[0] is before
    session.submit(lambda: session.choose_scene(scene="nowhere"))
    session.tick()
    assert "'nowhere'" in session.message
    assert session.scene == "slot"
    session.submit(lambda: session.choose_policies("no/such/agent"))
    session.tick()
    assert "no 'no/such/agent', expected" in session.message
    assert session.policies == ("agent",)
    lanes = session.lanes
    session.submit(lambda: session.choose_policies("scripted", "no/such/agent"))
    session.tick()
    assert session.lanes is lanes
    session.tick()
    assert session.snapshots


def test_of_the_moves_of_one_drag_only_the_last_is_carried_out(session) -> None:
    session.paused = True
    started = []
    lane = session.lanes[0]
    start = lane.start
    lane.start = lambda scenario: started.append(scenario) or start(scenario)
    for y in np.linspace(0.0, 0.2, 9).tolist():
        session.submit(lambda y=y: session.move_goal(0.3, y), "goal")
    session.tick()
    del lane.start
    assert [scenario.goal_position for scenario in started] == [(0.3, 0.2)]


def test_a_pause_a_single_step_and_the_same_seed_again(session) -> None:
    first = session.snapshots[0]
    session.step_once()
    session.tick()
    assert session.paused
    assert session.snapshots[0].step == 1
    session.set_paused(False)
    session.tick()
    after = session.snapshots[0]
    session.reset(0)
    assert session.snapshots[0].object_pose == first.object_pose
    session.tick()
    session.tick()
    assert session.snapshots[0].object_pose == after.object_pose
    session.next_episode()
    assert session.seed == 1
    assert session.snapshots[0].object_pose != first.object_pose


def test_the_next_episode_begins_by_itself(session) -> None:
    session.set_auto_continue(True)
    run(session)
    for _ in range(15):
        session.tick()
    assert session.seed == 1
    assert not session.ended


def test_two_policies_stand_side_by_side_on_one_scene(session) -> None:
    session.choose_policies("agent", "hand")
    agent, hand = session.snapshots
    assert agent.scenario is hand.scenario
    assert session.lanes[0].policy is not session.lanes[1].policy
    for _ in range(8):
        session.push_by_hand(0.0, 1.0)
        session.tick()
    moved = np.subtract(session.snapshots[1].ee_pose, hand.ee_pose)
    assert moved[:2] == pytest.approx([0.0, 8 * 0.02], abs=0.02)
    session.move_goal(0.35, -0.2)
    assert [shown.scenario.goal_position for shown in session.snapshots] == [(0.35, -0.2)] * 2


def test_the_hand_lets_go_after_a_few_steps(session) -> None:
    session.choose_policies("hand")
    session.push_by_hand(0.0, 1.0)
    for _ in range(8):
        session.tick()
    stood = session.snapshots[0].ee_pose
    session.tick()
    assert session.snapshots[0].ee_pose == pytest.approx(stood, abs=1e-3)


@pytest.mark.parametrize("policy", ["corridor", "scripted"])
def test_another_policy_shows_its_path_and_sub_goal(session, policy) -> None:
    session.choose_scene(scene="free")
    session.choose_policies(policy)
    session.tick()
    shown = session.snapshots[0]
    assert shown.path.shape[1] == 2
    assert len(shown.subgoal) == 2
    run(session)
    assert session.snapshots[0].flags["success"]


@pytest.mark.parametrize("pushed_object", ["large_cube", "small_cylinder", "fragment"])
def test_another_object_is_pushed_without_a_new_environment(session, pushed_object) -> None:
    lane = session.lanes[0]
    session.choose_scene(pushed_object=pushed_object)
    session.tick()
    assert session.lanes[0] is lane
    assert session.snapshots[0].scenario.pushed_object == pushed_object


def test_only_the_obstacle_that_is_hit_turns_red(session) -> None:
    shown = session.snapshots[0]
    first, second = (Obstacle((0.05, 0.05, 0.05), (0.5, y, 0.0)) for y in (-0.1, 0.1))
    scenario = replace(shown.scenario, obstacles=(first, second))
    hit = {"obstacle_contact": True, "tool_obstacle_contact": False}
    shown = replace(shown, scenario=scenario, object_pose=(0.5, 0.05, 0.0), flags=hit)
    assert _hit_obstacles(shown) == {1}
    tool = {"obstacle_contact": True, "tool_obstacle_contact": True}
    assert _hit_obstacles(replace(shown, ee_pose=(0.5, -0.06, 0.0), flags=tool)) == {0, 1}
    assert _hit_obstacles(replace(shown, flags=dict.fromkeys(hit, False))) == set()


def test_goal_poses_are_drawn_moved_and_turned() -> None:
    config = PlayConfig(policy=("hand",), goal="pose", scene="free", pushed_object="box")
    session = Session(config)
    session.paused = True
    first = session.snapshots[0].scenario
    assert first.goal_yaw is not None
    session.submit(lambda: session.move_goal(0.5, 0.1))
    session.tick()
    assert session.snapshots[0].scenario.goal_yaw == first.goal_yaw
    x, y, yaw = session.snapshots[0].object_pose
    session.submit(lambda: session.move_goal(x, y, yaw + 1.0))  # there, but turned
    session.tick()
    assert not session.message
    assert session.snapshots[0].scenario.goal_yaw == pytest.approx(yaw + 1.0)
    session.submit(lambda: session.move_goal(x, y, yaw))
    session.tick()
    assert "or be turned by more than" in session.message
    assert session.snapshots[0].scenario.goal_yaw == pytest.approx(yaw + 1.0)
    session.close()


def test_the_shipped_agent_for_poses_acts_where_the_goal_is_a_pose() -> None:
    """A bar that moves towards the goal, seen with its velocity."""
    config = PlayConfig(goal="pose", scene="moving_bar", pushed_object="box", seed=3)
    session = Session(config)
    before = session.snapshots[0]
    for _ in range(15):
        session.tick()
    shown = session.snapshots[0]
    assert np.linalg.norm(np.subtract(shown.ee_pose, before.ee_pose)) > 0.05
    session.close()


def test_a_goal_position_cannot_be_turned(session) -> None:
    session.submit(lambda: session.move_goal(0.5, 0.1, 0.3))
    session.tick()
    assert "The goal is a position, which has no yaw" in session.message


def test_the_page_shows_a_goal_pose_as_the_object() -> None:
    page = Page(
        PlayConfig(policy=("hand",), goal="pose", scene="free", pushed_object="box", port=0)
    )
    try:
        view, session = page._views[0], page.session
        yaw = session.snapshots[0].scenario.goal_yaw
        assert view._goal.wxyz == pytest.approx((np.cos(yaw / 2), 0, 0, np.sin(yaw / 2)), abs=1e-6)
        part = _flat(get_object("box").parts[0])
        assert part.size == pytest.approx((0.05, 0.025, 0.002))
        assert _flat(get_object("small_cylinder").parts[0]).size == pytest.approx((0.03, 0.002, 0))
    finally:
        page.close()
