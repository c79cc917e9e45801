"""`DepthNoise` on a depth image, and in front of the planner's grid."""

import pytest
import torch
from tensordict import TensorDict
from torchrl.envs import TransformedEnv
from torchrl.envs.utils import check_env_specs

from modpush.envs import PushEnv
from modpush.mdp import DepthNoise
from modpush.planners import OccupancyGrid


def images() -> TensorDict:
    return TensorDict({"camera": {"depth": torch.full((2, 1, 256, 256), 1.1)}}, batch_size=[2])


def test_noise_and_missing_pixels_have_the_given_size() -> None:
    torch.manual_seed(0)
    noise = DepthNoise(sigma=0.003, dropout=0.1, depth_key=("camera", "depth"))
    depth = noise(images())["camera", "depth"]
    missing = depth == 0
    # 131072 pixels: the standard errors are 0.0008 of the share and 6e-6 m of the deviation.
    assert missing.float().mean() == pytest.approx(0.1, abs=0.004)
    assert depth[~missing].std() == pytest.approx(0.003, abs=3e-5)
    assert depth[~missing].mean() == pytest.approx(1.1, abs=5e-5)
    again = noise(images())["camera", "depth"]
    assert not torch.equal(depth, again)  # anew in every step
    torch.manual_seed(0)
    assert torch.equal(depth, noise(images())["camera", "depth"])


def test_it_goes_before_the_planner_s_grid() -> None:
    """Missing pixels leave holes in the obstacles' cells; noise of a centimetre blocks free ones."""
    env = TransformedEnv(PushEnv(1, scene="slot", seed=0), OccupancyGrid(inflation=0.0))
    blocked = env.reset()["occupancy"].clone()
    env.insert_transform(0, DepthNoise(dropout=0.5))
    check_env_specs(env)
    with_holes = env.reset(scenarios=env.base_env.scenarios)["occupancy"]
    env.close()
    noisy = TransformedEnv(PushEnv(1, scene="slot", seed=0), OccupancyGrid(inflation=0.0))
    noisy.insert_transform(0, DepthNoise(sigma=0.01))
    check_env_specs(noisy)
    assert noisy.reset()["occupancy"].sum() > 2 * blocked.sum()
    noisy.close()
    assert 0 < with_holes.sum() < 0.8 * blocked.sum()


def test_stored_transitions_get_it_before_and_after_the_step() -> None:
    step = images().set("next", images())
    noisy = DepthNoise(sigma=0.003, depth_key=("camera", "depth"))(step)
    for image in (noisy["camera", "depth"], noisy["next", "camera", "depth"]):
        assert image.std() == pytest.approx(0.003, abs=3e-5)


def test_where_nothing_is_seen_there_is_no_noise() -> None:
    data = images()
    data["camera", "depth"][:, :, :100] = 0.0
    depth = DepthNoise(sigma=0.003, depth_key=("camera", "depth"))(data)["camera", "depth"]
    assert (depth[:, :, :100] == 0).all()
    assert (depth[:, :, 100:] > 1.0).all()
