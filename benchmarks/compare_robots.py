"""Compare the shipped agents, unchanged, with each of the robots on the same episodes.

    python benchmarks/compare_robots.py                 # both agents, all objects, in SAPIEN
    python benchmarks/compare_robots.py --sets tuning/small_cube --robots ur10 panda
    python benchmarks/compare_robots.py --engine mujoco --agents any_object --sets obstacles/small_cube

Each robot gets the set's first episodes whose start its tool reaches, and so does the UR5 beside it; the
`ur3`, whose reach does not hold the workspace, as many episodes that are drawn nearer to it. "within" are
the episodes that begin and end where the tool can stand on all sides of the object, told by
`Robot.reach` alone. A row is printed as soon as it is known.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import tyro

from modpush import load_agent
from modpush.envs import OBSTACLE_SCENES, ROBOTS, ScenarioConfig, sample_scenario, within_reach
from modpush.envs.scenes.scenario import Scenario
from modpush.evaluation import EpisodeMetrics, EvaluationSet, load_set, run_episodes

SMALL = {"max_start_radius": 0.42, "max_goal_radius": 0.42}
"""Where the episodes of the `ur3` begin and end [m]."""
SIDE = 0.08
"""Distance from the object's centre to the tool's tip beside it [m]."""


@dataclass
class Config:
    """What to compare."""

    robots: tuple[str, ...] = tuple(name for name in ROBOTS if name != "ur5")
    """Robots to compare with the UR5."""
    agents: tuple[str, ...] = ("any_object", "small_cube")
    """Names of shipped agents."""
    sets: tuple[str, ...] = (
        "obstacles/small_cube",
        "obstacles/large_cube",
        "obstacles/small_cylinder",
        "obstacles/fragment",
        "free/small_cube",
    )
    """Evaluation sets."""
    episodes: int = 60
    """Number of episodes of each set."""
    engine: str = "sapien"
    """Physics engine."""
    num_envs: int = 6
    """Number of scenes that are stepped together."""


def small_episodes(known: EvaluationSet, count: int) -> list[Scenario]:
    """Episodes near the `ur3`, of a set's object, in layouts of its kind."""
    config = ScenarioConfig(
        scene="free" if known.name.startswith("free/") else tuple(OBSTACLE_SCENES),
        pushed_object=known.objects,
        difficulty=(0.0, 0.3),
        distance=(0.08, 0.2),
        **SMALL,
    )
    return [
        sample_scenario(np.random.default_rng([7, n]), config, robot="ur3") for n in range(count)
    ]


def episodes_of(robot: str, known: EvaluationSet, count: int) -> list[Scenario]:
    """The first episodes of a set that a robot can begin."""
    if robot == "ur3":
        return small_episodes(known, count)
    return within_reach(known.first(2 * count), robot)[:count]


def is_within(robot: str, scenario: Scenario) -> bool:
    """The tool can stand on all sides of the object at its start and at the goal."""
    (least, most), base = ROBOTS[robot].reach, ROBOTS[robot].base[:2]
    places = np.array([scenario.object_pose[:2], scenario.goal_position])
    distance = np.linalg.norm(places - base, axis=1)
    return bool((distance >= least + SIDE).all() and (distance <= most - SIDE).all())


def run(
    robot: str, agent_name: str, episodes: Sequence[Scenario], config: Config
) -> list[EpisodeMetrics]:
    """Metrics of each episode."""
    agent = load_agent(agent_name)
    objects = tuple({scenario.pushed_object for scenario in episodes})
    env = agent.make_env(
        config.num_envs,
        robot=robot,
        engine=config.engine,
        pushed_object=objects,
        **(SMALL if robot == "ur3" else {}),
    )
    found = {e.number: e.metrics for e in run_episodes(env, agent.policy, enumerate(episodes))}
    env.close()
    return [found[number] for number in range(len(episodes))]


def row(
    names: Sequence[str],
    ours: Sequence[EpisodeMetrics],
    ur5: Sequence[EpisodeMetrics],
    within: np.ndarray,
) -> str:
    """A row of the table, and the numbers of the unsolved episodes as a comment."""
    solved, beside = (np.array([m.success for m in all_of]) for all_of in (ours, ur5))
    contact = [np.mean([m.contact_rate for m in all_of]) for all_of in (ours, ur5)]
    steps = [np.mean([m.steps for m in all_of]) for all_of in (ours, ur5)]
    rates = f"{solved.mean():.3f} | {beside.mean():.3f} | {(solved == beside).mean():.3f}"
    return (
        f"| {' | '.join(names)} | {len(solved)} | {rates} | {within.sum()} "
        f"| {solved[within].mean():.3f} | {contact[0]:.3f} / {contact[1]:.3f} "
        f"| {steps[0]:.1f} / {steps[1]:.1f} |\n"
        f"<!-- unsolved: {np.flatnonzero(~solved)} {np.flatnonzero(~beside)} -->"
    )


def main(config: Config) -> None:
    """Print a table in Markdown."""
    print(
        "| robot | agent | set | episodes | solved | UR5 | agreement | within | solved | contact "
        "| steps |\n|---|---|---|---|---|---|---|---|---|---|---|",
        flush=True,
    )
    for agent in config.agents:
        for name in config.sets:
            known, of_ur5 = load_set(name), {}
            for robot in config.robots:
                episodes = episodes_of(robot, known, config.episodes)
                if new := [scenario for scenario in episodes if scenario not in of_ur5]:
                    of_ur5.update(zip(new, run("ur5", agent, new, config), strict=True))
                ours = run(robot, agent, episodes, config)
                within = np.array([is_within(robot, scenario) for scenario in episodes])
                ur5 = [of_ur5[scenario] for scenario in episodes]
                print(row((robot, agent, name), ours, ur5, within), flush=True)


if __name__ == "__main__":
    main(tyro.cli(Config, description=__doc__))
