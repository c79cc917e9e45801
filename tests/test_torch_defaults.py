"""Parts do the same whatever torch's default dtype and default device are."""

from collections.abc import Iterator

import pytest
import torch
from tensordict import TensorDict
from torchrl.envs import check_env_specs

from modpush.encoders import DepthVAE, RayScan, egocentric_window
from modpush.mdp import Curriculum, CurriculumScenes, StuckRecovery
from modpush.planners import LazyThetaStar, OccupancyGrid, OccupancyMap, Paths
from modpush.planners.paths import check_paths
from modpush.recipes import PushEnvConfig, get_method, load_agent, make_push_env
from modpush.replay import MirrorTransitions, ReplayConfig, make_replay_buffer

CPU = torch.device("cpu")


@pytest.fixture
def double() -> Iterator[None]:
    torch.set_default_dtype(torch.float64)
    yield
    torch.set_default_dtype(torch.float32)


@pytest.fixture
def elsewhere() -> Iterator[None]:
    """A default device that nobody can compute on stands for a GPU beside tensors on the CPU."""
    with torch.device("meta"):
        yield


def test_an_environment_writes_what_its_specs_say(double: None) -> None:
    env = make_push_env(PushEnvConfig(num_envs=2, encoder="rays", path_ahead=(0.1,)), seed=0)
    env.append_transform(StuckRecovery())
    env.append_transform(CurriculumScenes(Curriculum()))
    check_env_specs(env)
    env.close()


def actions(policy: str) -> torch.Tensor:
    method = get_method(policy)
    env = method.make_env(1, ["small_cube"], seed=3)
    try:
        return env.rollout(8, method.make_policy())["action"]
    finally:
        env.close()


@pytest.mark.parametrize("policy", ["scripted", "corridor", "corridor_faithful", "agent"])
def test_policies_act_alike(policy: str, request: pytest.FixtureRequest) -> None:
    expected = actions(policy)
    request.getfixturevalue("double")
    torch.testing.assert_close(actions(policy), expected, atol=1e-5, rtol=0)  # and the dtype


def test_weights_keep_the_dtype_of_their_file(double: None) -> None:
    network = load_agent("small_cube").actor
    dtypes = {value.dtype for value in network.parameters()}
    assert dtypes == {torch.float32}
    assert {value.dtype for value in DepthVAE.from_pretrained().parameters()} == {torch.float32}
    assert torch.get_default_dtype() == torch.float64


def test_paths_of_your_own_are_single(double: None) -> None:
    start = torch.zeros(2, 2, dtype=torch.float32)
    check_paths(Paths.from_waypoints([None, torch.ones(2, 2)], start), 2)


def test_images_are_read_where_they_are(elsewhere: None) -> None:
    with CPU:
        depth, pose = torch.full((2, 256, 256), 1.1), torch.tensor([[0.6, 0.0, 0.3]] * 2)
        rays = RayScan()
    window = egocentric_window(depth, None, pose)
    assert rays(window).shape == (2, 32)
    blocked, _ = OccupancyMap()(depth, 0.03)
    grid = OccupancyGrid(bounds=((0.3, -0.3), (0.9, 0.3)), segmentation_key=None)
    state = {"depth": depth[:, None], "object_pose": pose}
    found = grid._reset(TensorDict({}, [2], device=CPU), TensorDict(state, [2], device=CPU))
    assert found["occupancy"].any()
    paths = LazyThetaStar().plan(blocked, pose[:, :2] * 100, pose[:, :2] * 200)
    assert paths.found.all()


def test_buffers_hold_what_is_on_the_cpu(elsewhere: None) -> None:
    with CPU:
        observation = torch.randn(31, 4)
        done = torch.zeros(30, 1, dtype=torch.bool)
        after = {"observation": observation[1:], "reward": torch.randn(30, 1)}
        after |= {"mirrored_observation": -observation[1:]}
        after |= {"done": done, "terminated": done.clone()}
        now = {"observation": observation[:-1], "mirrored_observation": -observation[:-1]}
        now |= {"action": torch.rand(30, 3)}
        mirror = MirrorTransitions()
    config = ReplayConfig(capacity=40, batch_size=6, num_queries=4)
    buffer = make_replay_buffer(config)
    buffer.append_transform(mirror)
    for _ in range(3):
        buffer.extend(TensorDict({**now, "next": after}, [30], device=CPU))
    sample = buffer.sample()
    assert sample["next", "observation"].device == CPU
