import warnings

import pytest
import torch

from modpush._extras import warn_experimental
from modpush.envs import OBJECTS
from modpush.envs.engines.base import SceneSpec
from modpush.envs.engines.sapien.cuda_batch import CudaBatch
from modpush.envs.robot.named import ROBOTS, TOOLS

SPEC = SceneSpec(
    robot=ROBOTS["ur5"],
    tool=TOOLS["2f85"],
    objects=(OBJECTS["small_cube"],),
    sim_freq=120,
    control_freq=15,
)


@pytest.mark.skipif(torch.cuda.is_available(), reason="there is a CUDA device")
def test_it_warns_once_that_it_is_experimental() -> None:
    warn_experimental.cache_clear()
    with (
        pytest.warns(UserWarning, match="PushEnv on CUDA is experimental: .* never been run"),
        pytest.raises(ValueError, match="needs CUDA"),
    ):
        CudaBatch(2, SPEC, None, False)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        with pytest.raises(ValueError, match="needs CUDA"):
            CudaBatch(2, SPEC, None, False)
