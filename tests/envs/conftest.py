"""Environments that are expensive to build, shared by the tests of a session."""

from collections.abc import Iterator

import pytest

from modpush.envs import PushEnv


@pytest.fixture(scope="session")
def env() -> Iterator[PushEnv]:
    """Three scenes with obstacles, images on."""
    env = PushEnv(3, scene="slot", seed=0)
    yield env
    env.close()
