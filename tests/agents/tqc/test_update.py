"""`TQCUpdate`: one optimisation step, in every execution."""

import warnings

import pytest
import torch
from torchrl.envs import GymEnv
from torchrl.objectives import SoftUpdate

from modpush.agents import TQCConfig, TQCLoss, TQCUpdate, make_tqc
from tests.agents.tqc.tqc_builders import make_batch, make_loss, make_pendulum_batch


def test_compiled_update_equals_the_eager_one(monkeypatch):
    results = []
    compile_eagerly = torch.compile
    monkeypatch.setattr(
        torch, "compile", lambda function: compile_eagerly(function, backend="eager")
    )
    for execution in ("eager", "compile"):
        loss = make_loss(TQCLoss)
        optimizer = torch.optim.SGD([p for p in loss.parameters() if p.requires_grad], lr=1e-3)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)  # dynamo on tensordict's locks
            update = TQCUpdate(loss, optimizer, SoftUpdate(loss, tau=0.1), execution=execution)
            torch.manual_seed(0)
            output = update(make_batch(6))
        results.append((output, loss.state_dict()))
    for key, value in results[0][0].items():
        torch.testing.assert_close(results[1][0][key], value)
    for name, value in results[0][1].items():
        torch.testing.assert_close(results[1][1][name], value)


@pytest.mark.gpu
@pytest.mark.skipif(not torch.cuda.is_available(), reason="no CUDA device")
def test_cuda_graphs_learn_like_eager_updates():
    env, ends = GymEnv("Pendulum-v1"), []
    for execution in ("eager", "cudagraph"):
        torch.manual_seed(0)
        config = TQCConfig(hidden_sizes=(16,), device="cuda", execution=execution)
        agent = make_tqc(config, env)
        for seed in range(30):
            result = agent.update(make_pendulum_batch(seed).to("cuda"))
        ends.append(result["loss_qvalue"].item())
    assert ends[0] == pytest.approx(ends[1], rel=0.3)


def test_unknown_executions_and_missing_devices_are_refused():
    loss = make_loss(TQCLoss)
    with pytest.raises(ValueError, match=r"execution must be one of \('eager', .*, got 'fast'."):
        TQCUpdate(loss, None, None, execution="fast")
    message = r"'cudagraph' needs parameters on a CUDA device, got cpu\."
    with pytest.raises(ValueError, match=message):
        TQCUpdate(loss, None, None, execution="cudagraph")
