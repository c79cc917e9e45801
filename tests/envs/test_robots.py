"""The choice of an arm and a tool, and what belongs to them."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation
from torchrl.envs.utils import check_env_specs

from modpush import PushEnvConfig, load_agent, make_push_env
from modpush.envs import PushEnv, PushState, sample_scenario, within_reach
from modpush.envs.engines.base import ENGINES
from modpush.envs.robot.named import ROBOTS, TOOLS
from modpush.envs.robot.robot import Joint, Link, Robot, Tool
from modpush.envs.scenes.conditions import EpisodeConditions
from modpush.envs.scenes.scenario import ScenarioConfig
from modpush.envs.simulation_config import SimulationConfig
from modpush.evaluation import load_set, run_episodes
from modpush.geometry import box, cylinder
from modpush.recipes import environment_fingerprint
from modpush.recipes.fingerprint import fingerprint_differences
from modpush.viewer import PlayConfig
from tests.examples import load_example

UR10 = ROBOTS["ur10"]
SMALL = {"max_start_radius": 0.42, "max_goal_radius": 0.42, "distance": (0.08, 0.2)}
SPOON = Tool(
    name="spoon",
    mass=0.3,
    length=0.2,
    tip_half_extents=(0.02, 0.015),
    shapes=(cylinder(0.015, 0.15, (0.0, 0.0, 0.075)), box(0.04, 0.03, 0.05, (0.0, 0.0, 0.175))),
)


def workspace(robot: str) -> dict:
    return SMALL if robot == "ur3" else {}


def tip_errors(env: PushEnv, steps: int = 25) -> torch.Tensor:
    """Distance of the tip from where it is commanded to be, `[steps, B]` [m], at random actions."""
    generator, td, found = torch.Generator().manual_seed(0), env.reset(), []
    for _ in range(steps):
        td["action"] = torch.rand(*env.batch_size, 3, generator=generator) * 2 - 1
        td = env.step(td)["next"]
        assert td["target_reachable"].all()
        target = torch.from_numpy(env._batch._target[:, :2]).float()
        free = ~(td["tool_obstacle_contact"] | td["object_contact"]).squeeze(-1)
        found.append((td["ee_pose"][:, :2] - target).norm(dim=-1)[free])
    return torch.cat(found)


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("robot", ROBOTS)
def test_every_robot_keeps_the_contract_and_follows_its_targets(robot, engine) -> None:
    env = PushEnv(2, robot=robot, engine=engine, depth=None, seed=1, **workspace(robot))
    check_env_specs(env, check_dtype=True)
    assert env.reset()["joint_position"].shape == (2, len(ROBOTS[robot].joints))
    assert tip_errors(env).max() < (0.002 if engine == "sapien" else 0.005)
    heights = [engine.link_transforms(("tip",))[0][2] for engine in env._batch.engines]
    assert heights == pytest.approx([0.02, 0.02], abs=2e-3)
    env.close()


@pytest.mark.parametrize("engine", ENGINES)
def test_a_state_continues_in_another_environment_with_this_robot_and_in_no_other(engine) -> None:
    options = {"engine": engine, "depth": None, "seed": 3}
    one, other = (PushEnv(1, robot="ur10", **options) for _ in range(2))
    td = one.reset()
    for _ in range(5):
        td = one.step(td.set("action", torch.ones(1, 3)))["next"]
    state = PushState.from_dict(one.get_state().to_dict())
    ends = []
    for env in (one, other):
        td = env.reset(state=state)
        for _ in range(5):
            td = env.step(td.set("action", -torch.ones(1, 3)))["next"]
        ends.append(td["joint_position"])
    assert torch.equal(*ends)
    ur5 = PushEnv(1, **options)
    with pytest.raises(ValueError, match=r"with robot='ur10' \(expected 'ur5'\)"):
        ur5.set_state(state)
    ur5.reset()
    old = ur5.get_state()
    known = {k: v for k, v in old.config.items() if k != "robot"}
    ur5.set_state(replace(old, config=known))  # from before there were others
    for env in (one, other, ur5):
        env.close()


def test_the_same_seed_draws_the_same_layouts_where_the_arm_has_room() -> None:
    config = ScenarioConfig(scene="slot", distance=(0.2, 0.3))
    drawn = [
        sample_scenario(np.random.default_rng(4), config, robot=robot) for robot in ("ur5", "ur10")
    ]
    assert drawn[0].obstacles == drawn[1].obstacles


@pytest.mark.parametrize("wrong", ["kuka", "", 3, None])
def test_an_unknown_robot_or_tool_is_refused_with_the_known_ones(wrong) -> None:
    for name, known in (("robot", [*ROBOTS]), ("tool", [*TOOLS])):
        message = (
            rf"{name} must be one of \{str(sorted(known))[:-1]}\] or 'module:name'.*got {wrong!r}"
        )
        with pytest.raises(ValueError, match=f"SimulationConfig: {message}"):
            PushEnv(1, **{name: wrong})
        with pytest.raises(ValueError, match=name):
            EpisodeConditions(**{name: wrong})
        if wrong is not None:
            told = f"PlayConfig: {message}" if wrong == "kuka" else "PlayConfig"
            with pytest.raises(ValueError, match=told):
                PlayConfig(**{name: wrong})


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"robot": "ur3"}, r"robot 'ur3'.*reaches from 0.16 to 0.52 m.*hold the workspace from"),
        ({"robot": "modpush.envs:OBJECTS"}, "robot must be a Robot, got"),
        ({"robot": "modpush.envs:nothing"}, "has no attribute 'nothing'"),
        ({"tool": "modpush.envs:OBJECTS"}, "tool must be a Tool, got"),
        ({"robot": replace(UR10, solve=lambda pose, last: last)}, "solve must return finite"),
        (
            {"robot": replace(UR10, solve=lambda pose, last: (last, np.zeros(len(pose), bool)))},
            "out of the arm's reach, got .* robot 'ur10', whose inverse kinematics finds nothing",
        ),
    ],
)
def test_what_cannot_work_is_said_at_the_start(options, message) -> None:
    with pytest.raises(ValueError, match=message):
        PushEnv(1, depth=None, **options).reset()


def test_a_workspace_beyond_reach_is_refused_later_too() -> None:
    env = PushEnv(1, depth=None, robot="ur3", **SMALL)
    with pytest.raises(ValueError, match="does not hold the workspace"):
        env.scenario = ScenarioConfig()
    env.close()


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"home": UR10.home[:5]}, "6 joints need 7 links and 6 home angles, got 7 and 5"),
        ({"home": (9.0, *UR10.home[1:])}, "home of 'shoulder_pan' must be within its limits"),
        ({"links": (*UR10.links[:6], replace(UR10.links[6], name="tool"))}, "different names"),
        ({"reach": (0.5, 0.4)}, "reach: Input should be a range"),
        ({"solve": 3}, "solve must be a function"),
        ({"joints": ()}, "joints"),
        (
            {
                "joints": UR10.joints[:5],
                "links": UR10.links[:6],
                "home": UR10.home[:5],
                "solve": None,
            },
            "6 joints or more are needed to hold the tool down at any place and yaw, got 5",
        ),
    ],
)
def test_a_robot_that_does_not_fit_together_is_refused(changes, message) -> None:
    with pytest.raises(ValueError, match=message):
        replace(UR10, **changes)


def test_an_arm_that_is_too_small_is_refused_with_what_each_command_can_do() -> None:
    message = (
        "max_start_radius .* of at most 0.51, .* demo and play have an option for the robot alone"
    )
    with pytest.raises(ValueError, match=message):
        PushEnv(1, depth=None, robot="ur3")


@pytest.mark.parametrize(
    ("limits", "message"),
    [
        (
            (-180.0, 180.0),
            r"Joint 'pan': limits must be in radians .* math.radians converts degrees",
        ),
        ((2.0, -2.0), r"Joint 'pan': limits must be \(smallest, largest\), got \(2.0, -2.0\)"),
    ],
)
def test_limits_in_degrees_or_swapped_are_refused_by_the_joint(limits, message) -> None:
    with pytest.raises(ValueError, match=message):
        Joint(name="pan", limits=limits, effort=1.0)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        (
            {"reach": (0.5, 1.27)},
            r"reaches from 0.5 to 1.27 m; the workspace .* begins 0.30 m from",
        ),
        (
            {"base": (3.0, 0.0, 0.0)},
            r"up to 2.[0-9]+ m from the base. Expected a Robot.base nearer",
        ),
        ({"base": (-0.1, 0.0, -0.9)}, r"at home the flange of robot 'ur10' is at .* z > 0"),
        ({"flange_rpy": (np.pi, 0.0, 0.0)}, r"its z axis points along .* expected .* down"),
    ],
)
def test_an_arm_that_stands_wrongly_is_refused_with_what_is_wrong(changes, message) -> None:
    with pytest.raises(ValueError, match=message):
        PushEnv(1, depth=None, robot=replace(UR10, **changes))


def test_a_part_that_is_no_robot_or_not_importable_is_told_in_a_few_words() -> None:
    with pytest.raises(ValueError, match=r"got a dict from 'modpush.envs:OBJECTS'\.$"):
        PushEnv(1, robot="modpush.envs:OBJECTS")
    with pytest.raises(
        ValueError, match=r"folder of PYTHONPATH; for the current folder, PYTHONPATH=\."
    ):
        PushEnv(1, robot="no_such_module:ARM")
    with pytest.raises(ValueError, match=r"or 'module:name' or a Robot, got './my_arm\.py'"):
        PushEnv(1, robot="./my_arm.py")


def test_the_episodes_that_an_arm_can_begin_run_and_the_others_are_told_by_number() -> None:
    far = load_set("tuning/small_cube").first(10)  # the tenth starts 83 cm from the origin
    kept = within_reach(far, "panda")
    assert kept == [*far.scenarios[:9]]
    assert within_reach(far) == [*far.scenarios]
    own = far.with_conditions(robot="panda").within_reach()
    assert (own.scenarios, own.conditions.robot) == (tuple(kept), "panda")
    assert far.within_reach() is far
    env = PushEnv(2, robot="panda", depth=None)
    env.reset(scenarios=kept[:2])
    message = r"^scenarios\[1\]: .*within_reach leaves .* The scenarios are the episodes \[8, 9\]"
    with pytest.raises(ValueError, match=message):
        next(run_episodes(env, lambda td: td, [(n, far.scenarios[n]) for n in (8, 9)]))
    env.close()


def test_an_error_in_a_robot_s_own_solve_is_not_taken_for_a_place_out_of_reach() -> None:
    def broken(pose, last):
        raise ValueError("a mistake in solve")

    start = load_set("obstacles/small_cube").first(1)
    with pytest.raises(ValueError, match="a mistake in solve"):
        within_reach(start, replace(ROBOTS["ur5"], solve=broken))
    with pytest.raises(ValueError, match="solve must return finite joints"):
        within_reach(start, replace(ROBOTS["ur5"], solve=lambda pose, last: (last, False)))


def test_solids_that_a_urdf_does_not_know_are_refused() -> None:
    from modpush.geometry import prism

    wedge = prism(((0.0, 0.0), (0.1, 0.0), (0.0, 0.1)), 0.1)
    with pytest.raises(
        ValueError, match="Link: shapes: Input should be boxes, cylinders and capsules"
    ):
        Link(name="a", mass=1.0, shapes=(wedge,))
    with pytest.raises(ValueError, match="Tool: shapes"):
        replace(SPOON, name="a", shapes=(wedge,))


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("tool", [SPOON, "tests.envs.test_robots:SPOON"], ids=["object", "name"])
def test_a_tool_of_your_own_is_used(tool, engine) -> None:
    env = PushEnv(1, tool=tool, engine=engine, arm_in_depth=True, scene="posts", seed=0)
    env.rollout(3)
    transforms = dict(
        zip(("tip", "tool"), env._batch.engines[0].link_transforms(("tip", "tool")), strict=True)
    )
    assert transforms["tool"][2] - transforms["tip"][2] == pytest.approx(0.2, abs=1e-4)
    assert env.render().ndim == 3
    env.close()


def plain_arm(**changes) -> Robot:
    """Six joints in another order than a UR's: an elbow manipulator with a spherical wrist."""
    turns = [(0.0, 0.0, 0.0), (-np.pi / 2, 0.0, 0.0), (0.0, 0.0, 0.0), (-np.pi / 2, 0.0, 0.0)]
    turns += [(np.pi / 2, 0.0, 0.0), (-np.pi / 2, 0.0, 0.0)]
    places = [(0.0, 0.0, 0.4), (0.0, 0.0, 0.0), (0.5, 0.0, 0.0), (0.0, 0.45, 0.0)]
    places += [(0.0, 0.0, 0.0), (0.0, 0.0, 0.0)]
    fields = {
        "name": "plain",
        "links": tuple(
            Link(name=f"link_{i}", mass=2.0, shapes=(cylinder(0.05, 0.05),)) for i in range(7)
        ),
        "joints": tuple(
            Joint(name=f"joint_{i}", position=place, rpy=turn, limits=(-3.0, 3.0), effort=100.0)
            for i, (place, turn) in enumerate(zip(places, turns, strict=True))
        ),
        "home": (0.0, -0.9, 0.5, 0.0, 0.4, 0.0),
        "reach": (0.2, 0.85),
        "flange_position": (0.0, 0.0, 0.1),
    }
    return Robot(**{**fields, **changes})


@pytest.mark.parametrize("engine", ENGINES)
def test_an_arm_of_your_own_needs_no_inverse_kinematics(engine) -> None:
    env = PushEnv(2, robot=plain_arm(), engine=engine, depth=None, seed=0)
    assert tip_errors(env, 10).max() < 0.005
    env.close()


@pytest.mark.parametrize("engine", ENGINES)
def test_joints_turn_about_the_axes_of_a_urdf(engine) -> None:
    arm = load_example("extending.robot").ARM
    env = PushEnv(2, robot=arm, engine=engine, depth=None, seed=0)
    assert tip_errors(env, 10).max() < (0.002 if engine == "sapien" else 0.005)
    names = [*(link.name for link in arm.links), "tool"]
    found = arm.link_transforms(env._batch.measure().joint_position[0])
    for transform, row in zip(found, env._batch.link_transforms_of(0, names), strict=True):
        rotation = Rotation.from_quat(row[3:], scalar_first=True).as_matrix()
        np.testing.assert_allclose(transform[:3, 3], row[:3], atol=2e-6)
        np.testing.assert_allclose(transform[:3, :3], rotation, atol=2e-6)
    env.close()


def test_an_axis_of_another_length_is_refused() -> None:
    with pytest.raises(
        ValueError, match=r"Joint 'pan': axis must be of length 1, got \(1.0, 1.0, 0.0\)"
    ):
        Joint(name="pan", axis=(1.0, 1.0, 0.0), limits=(-1.0, 1.0), effort=1.0)


def test_a_config_with_a_robot_makes_a_stack_with_it() -> None:
    config = PushEnvConfig.preset("cpu", robot="ur10", num_envs=1)
    assert config.simulation.robot == "ur10"
    env = make_push_env(config)
    assert environment_fingerprint(env)["robot"] == "ur10"
    env.close()


def test_joints_of_an_arm_with_another_home_are_observed_from_there() -> None:
    env = make_push_env(robot=plain_arm(), encoder="none", entries=["joint_position"])
    td = env.reset()
    torch.testing.assert_close(
        td["observation"], td["joint_position"] - torch.tensor(plain_arm().home).float()
    )
    env.close()


def test_an_agent_that_sees_no_joints_runs_with_another_robot() -> None:
    agent = load_agent("any_object")
    env = agent.make_env(1, robot="ur10", scene="free")
    now = environment_fingerprint(env)
    assert now["robot"] == "ur10"
    assert fingerprint_differences(agent.fingerprint, now) == []
    env.rollout(3, agent.policy)
    env.close()


def test_an_agent_that_sees_the_joints_of_a_robot_is_told_of_another() -> None:
    agent = load_agent("paper")
    message = r"robot: trained with 'ur5', this environment has 'ur10'"
    with pytest.raises(ValueError, match=message):
        agent.make_env(1, robot="ur10")
    agent.make_env(1, robot="ur5").close()


def test_a_set_with_another_robot_has_its_own_name(tmp_path) -> None:
    smoke = load_set("smoke")
    assert "robot" not in smoke.conditions.to_dict()
    assert smoke.with_conditions(robot="ur5") is smoke
    other = smoke.with_conditions(robot="ur10")
    assert (other.name, other.conditions.robot) == ("smoke+ur10", "ur10")
    other.save(tmp_path / "set.json.gz")
    assert load_set(tmp_path / "set.json.gz") == other
    own = smoke.with_conditions(robot="evil_module:thing")
    own.save(tmp_path / "own.json.gz")
    with pytest.raises(ValueError, match="evil_module"):
        load_set(tmp_path / "own.json.gz")
    assert SimulationConfig(robot="evil_module:thing").robot == "evil_module:thing"
