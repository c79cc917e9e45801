"""Environments that are expensive to build, shared by the tests of a session."""

from collections.abc import Iterator

import pytest

from modpush.envs import OBJECTS, SCENES, PushEnv
from modpush.envs.engines.sapien.maniskill_task import ClutterPushEnv


@pytest.fixture(scope="session")
def task() -> Iterator[ClutterPushEnv]:
    """All families, all objects, one CPU scene."""
    task = ClutterPushEnv(obs_mode="none", scene=list(SCENES), pushed_object=list(OBJECTS))
    yield task
    task.close()


@pytest.fixture(scope="session")
def env() -> Iterator[PushEnv]:
    """Three scenes with obstacles, images on."""
    env = PushEnv(3, scene="slot", seed=0)
    yield env
    env.close()
