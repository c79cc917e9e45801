"""Episodes made by hand, and environments that all tests here share."""

from collections.abc import Iterator, Sequence

import numpy as np
import pytest
from torchrl.envs import EnvBase, InitTracker, TransformedEnv

from modpush.envs import PushEnv, Scenario
from modpush.evaluation.episodes import Episode, Trajectory
from modpush.evaluation.metrics import episode_metrics
from modpush.evaluation.sets import EvaluationSet, load_set


def make_env(num_envs: int, objects: Sequence[str], depth: str | None = None) -> EnvBase:
    """Without an image, for policies that look at poses only: quick."""
    return TransformedEnv(
        PushEnv(num_envs, pushed_object=tuple(objects), depth=depth), InitTracker()
    )


@pytest.fixture(scope="session")
def env() -> Iterator[EnvBase]:
    env = make_env(3, ("small_cube",))
    yield env
    env.close()


@pytest.fixture(scope="session")
def free() -> EvaluationSet:
    return load_set("free/small_cube")


def make_episode(number: int, scenario: Scenario, *, success: bool = True) -> Episode:
    """An object that is pushed straight to the goal in two steps, or only halfway."""
    start, goal = np.array(scenario.object_pose), np.array(scenario.goal_position)
    shares = [0.0, 0.25, 1.0 if success else 0.5]
    poses = np.array([[*(start[:2] + k * (goal - start[:2])), start[2]] for k in shares])
    flags = np.array([[True, False, False], [True, False, True]])
    metrics = episode_metrics(
        object_position=poses[:, :2],
        goal_position=goal,
        reward=np.array([0.0, float(success)]),
        contacts=flags,
        contacts_at_end=flags,
        control_freq=15.0,
        ee_position=poses[:, :2],
        success=success,
        out_of_bounds=False,
        shortest_length=float(np.linalg.norm(goal - start[:2])),
    )
    trajectory = Trajectory(
        object_pose=poses.astype(np.float32),
        ee_pose=(poses - np.array([0.08, 0.0, 0.0])).astype(np.float32),
        contacts=flags,
        planned_path=np.stack([start[:2], goal]).astype(np.float32),
        target=np.tile(goal, (2, 1)).astype(np.float32),
    )
    return Episode(number=number, scenario=scenario, metrics=metrics, trajectory=trajectory)
