"""An arm of your own: six joints, a long upper arm and a spherical wrist, pushed by a shipped agent.

    python examples/extending/robot.py

Contract: a `Robot`, in metres and radians. Each joint turns about the z axis of its frame, which is given
in the frame of the link before it, as in a URDF.
"""

import math

from modpush import load_agent
from modpush.envs import Joint, Link, Robot
from modpush.evaluation import load_set, run_episodes
from modpush.geometry import capsule, cylinder

DOWN, UP = (-math.pi / 2, 0.0, 0.0), (math.pi / 2, 0.0, 0.0)  # turns of a joint's axis
ALONG_X, ALONG_Y = (0.0, math.pi / 2, 0.0), (math.pi / 2, 0.0, 0.0)  # of a solid's axis

LINKS = (
    Link(name="foot", mass=6.0, shapes=(cylinder(0.09, 0.15, (0.0, 0.0, 0.075)),)),
    Link(name="turret", mass=7.0, shapes=(cylinder(0.08, 0.16),)),
    Link(name="upper_arm", mass=9.0, shapes=(capsule(0.06, 0.62, (0.31, 0.0, 0.0), ALONG_X),)),
    Link(name="forearm", mass=5.0, shapes=(capsule(0.05, 0.50, (0.0, 0.26, 0.0), ALONG_Y),)),
    Link(name="wrist_1", mass=2.0, shapes=(cylinder(0.05, 0.10),)),
    Link(name="wrist_2", mass=2.0, shapes=(cylinder(0.05, 0.10),)),
    Link(name="wrist_3", mass=1.0, shapes=(cylinder(0.04, 0.06, (0.0, 0.0, 0.09)),)),
)
HALF, FULL = (-2.8, 2.8), (-6.2, 6.2)
ARM = Robot(
    name="long_arm",
    links=LINKS,
    joints=(
        Joint(name="pan", position=(0.0, 0.0, 0.22), limits=FULL, effort=300.0),
        Joint(name="lift", rpy=DOWN, limits=HALF, effort=300.0),
        Joint(name="elbow", position=(0.62, 0.0, 0.0), limits=HALF, effort=150.0),
        Joint(name="roll", position=(0.0, 0.56, 0.0), rpy=DOWN, limits=FULL, effort=50.0),
        Joint(name="tilt", rpy=UP, limits=HALF, effort=50.0),
        Joint(name="turn", rpy=DOWN, limits=FULL, effort=50.0),
    ),
    flange_position=(0.0, 0.0, 0.12),
    home=(0.0, -1.3, 0.9, 0.0, 0.4, 0.0),
    reach=(0.25, 1.0),  # of the tool, from the base's axis
    base=(-0.05, 0.0, 0.0),
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
