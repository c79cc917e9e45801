"""An arm of your own: a KUKA KR 6 R900, from its public URDF, pushed by a shipped agent.

    python examples/extending/robot.py

Contract: a `Robot`, in metres and radians. Frames and axes of the joints are given as in a URDF; this one
has no masses and no torques, which are guessed, and a few solids stand for its meshes.
"""

import math

from modpush import load_agent
from modpush.envs import Joint, Link, Robot
from modpush.evaluation import load_set, run_episodes
from modpush.geometry import capsule, cylinder

X, Y, Z = (-1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, -1.0)  # the joints' axes
ALONG_X, ALONG_Y = (0.0, math.pi / 2, 0.0), (math.pi / 2, 0.0, 0.0)  # turns of a solid's axis

LINKS = (
    Link(name="base", mass=15.0, shapes=(cylinder(0.09, 0.30, (0.0, 0.0, 0.15)),)),
    Link(name="link_1", mass=11.0, shapes=(cylinder(0.08, 0.16),)),
    Link(name="link_2", mass=10.0, shapes=(capsule(0.06, 0.45, (0.23, 0.0, 0.0), ALONG_X),)),
    Link(name="link_3", mass=7.0, shapes=(cylinder(0.06, 0.14, rpy=ALONG_Y),)),
    Link(name="link_4", mass=3.0, shapes=(capsule(0.05, 0.36, (0.22, 0.0, 0.0), ALONG_X),)),
    Link(name="link_5", mass=1.5, shapes=(cylinder(0.04, 0.08, rpy=ALONG_Y),)),
    Link(name="link_6", mass=0.5, shapes=(cylinder(0.03, 0.03, (-0.015, 0.0, 0.0), ALONG_X),)),
)
JOINTS = (  # position, axis, limits [degrees], torque
    ((0.0, 0.0, 0.4), Z, (-170, 170), 300.0),
    ((0.025, 0.0, 0.0), Y, (-190, 45), 300.0),
    ((0.455, 0.0, 0.0), Y, (-120, 156), 150.0),
    ((0.0, 0.0, 0.035), X, (-185, 185), 50.0),
    ((0.42, 0.0, 0.0), Y, (-120, 120), 50.0),
    ((0.08, 0.0, 0.0), X, (-350, 350), 30.0),
)
ARM = Robot(
    name="kr6",
    links=LINKS,
    joints=tuple(
        Joint(
            name=f"a{i}",
            position=position,
            axis=axis,
            limits=(math.radians(low), math.radians(high)),
            effort=effort,
        )
        for i, (position, axis, (low, high), effort) in enumerate(JOINTS, start=1)
    ),
    flange_rpy=ALONG_X,
    home=(0.0, -0.64, 2.09, 0.0, 0.12, 0.0),
    reach=(0.20, 0.88),  # of the tool, from the base's axis
    base=(-0.03, 0.0, 0.0),
)


def main(episodes: int = 8) -> float:
    """Run the agent, which was trained with a UR5, on some episodes; returns the share it solves."""
    agent, tasks = load_agent("any_object"), load_set("obstacles/small_cube").first(episodes)
    env = agent.make_env(4, robot=ARM)
    found = list(run_episodes(env, agent.policy, enumerate(tasks)))
    env.close()
    return sum(episode.metrics.success for episode in found) / episodes


if __name__ == "__main__":
    print(f"solved: {main():.2f}")
