"""Compare a shipped agent, unchanged, with each of the robots on the same episodes.

    python benchmarks/compare_robots.py                 # any_object, 60 episodes, in SAPIEN
    python benchmarks/compare_robots.py --engine mujoco --robots ur10 panda

Each robot gets the episodes of the set whose start its tool reaches, and so does the UR5 beside it; the
`ur3`, whose reach does not hold the workspace, as many episodes that are drawn nearer to it. "within" are
the episodes that begin and end where the tool can stand on all sides of the object.
"""

from dataclasses import dataclass

import numpy as np
import tyro

from modpush import load_agent
from modpush.envs import ScenarioConfig, sample_scenario
from modpush.envs.robot.control import start_joints
from modpush.envs.robot.named import ROBOTS
from modpush.envs.robot.tools import TOOLS
from modpush.envs.scenes.arm_room import check_arm_is_free
from modpush.envs.scenes.layouts import OBSTACLE_SCENES
from modpush.envs.scenes.objects import get_object
from modpush.envs.scenes.scenario import Scenario
from modpush.evaluation import EpisodeMetrics, load_set, run_episodes

SMALL = {"max_start_radius": 0.42, "max_goal_radius": 0.42}
"""Where the episodes of the `ur3` begin and end [m]."""
SIDE = 0.08
"""Distance from the object's centre to the tool's tip beside it [m]."""


@dataclass
class Config:
    """What to compare."""

    robots: tuple[str, ...] = tuple(name for name in ROBOTS if name != "ur5")
    """Robots to compare with the UR5."""
    agent: str = "any_object"
    """Name of the shipped agent."""
    set: str = "obstacles/small_cube"
    """Evaluation set."""
    episodes: int = 60
    """Number of episodes, the set's first ones."""
    engine: str = "sapien"
    """Physics engine."""
    num_envs: int = 6
    """Number of scenes that are stepped together."""


def small_episodes(count: int) -> list[Scenario]:
    """Episodes near the `ur3`."""
    config = ScenarioConfig(
        scene=tuple(OBSTACLE_SCENES), difficulty=(0.0, 0.3), distance=(0.08, 0.2), **SMALL
    )
    return [
        sample_scenario(np.random.default_rng([7, n]), config, robot="ur3") for n in range(count)
    ]


def fits(robot: str, scenario: Scenario) -> bool:
    """The arm reaches the start and stands in no obstacle there."""
    arm, tool = ROBOTS[robot], TOOLS["2f85"]
    height = get_object(scenario.pushed_object).tool_height
    try:
        start_joints(arm, tool, scenario.tool_pose, height)
        check_arm_is_free("start", scenario, height, tool, arm)
    except ValueError:
        return False
    return True


def is_within(robot: str, scenario: Scenario) -> bool:
    """The tool can stand on all sides of the object at its start and at the goal."""
    (least, most), base = ROBOTS[robot].reach, ROBOTS[robot].base[:2]
    places = np.array([scenario.object_pose[:2], scenario.goal_position])
    distance = np.linalg.norm(places - base, axis=1)
    return bool((distance >= least + SIDE).all() and (distance <= most - SIDE).all())


def run(robot: str, episodes: list[Scenario], config: Config) -> list[EpisodeMetrics]:
    """Metrics of each episode."""
    agent = load_agent(config.agent)
    workspace = SMALL if robot == "ur3" else {}
    objects = tuple({scenario.pushed_object for scenario in episodes})
    env = agent.make_env(
        config.num_envs, robot=robot, engine=config.engine, pushed_object=objects, **workspace
    )
    found = {e.number: e.metrics for e in run_episodes(env, agent.policy, enumerate(episodes))}
    env.close()
    return [found[number] for number in range(len(episodes))]


def main(config: Config) -> None:
    """Print a table in Markdown."""
    print("| robot | episodes | solved | UR5 | agreement | within | solved | contact | steps |")
    print("|---|---|---|---|---|---|---|---|---|")
    known = load_set(config.set).first(config.episodes)
    for robot in config.robots:
        drawn = small_episodes(config.episodes) if robot == "ur3" else known
        episodes = [scenario for scenario in drawn if fits(robot, scenario)]
        ours, ur5 = (run(name, episodes, config) for name in (robot, "ur5"))
        solved, beside = (np.array([m.success for m in all_of]) for all_of in (ours, ur5))
        within = np.array([is_within(robot, scenario) for scenario in episodes])
        contact = [np.mean([m.contact_rate for m in all_of]) for all_of in (ours, ur5)]
        steps = [np.mean([m.steps for m in all_of]) for all_of in (ours, ur5)]
        rates = f"{solved.mean():.3f} | {beside.mean():.3f} | {(solved == beside).mean():.3f}"
        print(
            f"| {robot} | {len(episodes)} | {rates} | {within.sum()} | {solved[within].mean():.3f} "
            f"| {contact[0]:.3f} / {contact[1]:.3f} | {steps[0]:.1f} / {steps[1]:.1f} |",
            flush=True,
        )
        print("<!-- unsolved:", np.flatnonzero(~solved), np.flatnonzero(~beside), "-->", flush=True)


if __name__ == "__main__":
    main(tyro.cli(Config, description=__doc__))
