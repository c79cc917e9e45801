import warnings

import pytest
import torch

from modpush._experimental import warn_experimental
from modpush.envs.sim.cuda_batch import CudaBatch


@pytest.mark.skipif(torch.cuda.is_available(), reason="there is a CUDA device")
def test_it_warns_once_that_it_is_experimental() -> None:
    warn_experimental.cache_clear()
    with (
        pytest.warns(UserWarning, match="PushEnv on CUDA is experimental: .* never been run"),
        pytest.raises(ValueError, match="needs CUDA"),
    ):
        CudaBatch(2, None, False)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        with pytest.raises(ValueError, match="needs CUDA"):
            CudaBatch(2, None, False)
