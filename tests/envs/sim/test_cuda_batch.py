import pytest
import torch

from modpush.envs.sim.cuda_batch import CudaBatch, warn_experimental


@pytest.mark.skipif(torch.cuda.is_available(), reason="there is a CUDA device")
def test_it_warns_once_that_it_is_experimental() -> None:
    warn_experimental.cache_clear()
    with (
        pytest.warns(UserWarning, match="CUDA is experimental: .* never been run"),
        pytest.raises(ValueError, match="needs CUDA"),
    ):
        CudaBatch(2, None, False)
    # A second warning would be an error here.
    with pytest.raises(ValueError, match="needs CUDA"):
        CudaBatch(2, None, False)
