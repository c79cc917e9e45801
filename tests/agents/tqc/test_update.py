"""`TQCUpdate`: one optimisation step, in every execution."""

import warnings

import pytest
import torch
from tensordict import TensorDict
from torchrl.envs import GymEnv
from torchrl.objectives import SoftUpdate

from modpush._precision import networks_in
from modpush.agents import TQCConfig, TQCLoss, TQCUpdate, make_tqc
from modpush.agents.tqc.ensemble import BatchedEnsemble
from modpush.agents.tqc.networks import make_critic
from tests.agents.tqc.tqc_builders import make_batch, make_loss, make_pendulum_batch


@pytest.mark.slow
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


def test_an_update_in_bfloat16_is_close_to_one_in_float32():
    losses, weights = {}, {}
    for precision in ("float32", "bfloat16"):
        torch.manual_seed(0)
        agent = make_tqc(
            TQCConfig(hidden_sizes=(64, 64), precision=precision), GymEnv("Pendulum-v1")
        )
        batch = make_pendulum_batch(256)
        torch.manual_seed(1)
        losses[precision] = agent.update(batch)
        weights[precision] = torch.cat([p.flatten() for p in agent.loss.parameters()])
    for key in ("loss_qvalue", "loss_actor", "loss_alpha"):
        torch.testing.assert_close(
            losses["bfloat16"][key], losses["float32"][key], rtol=0.02, atol=0.01
        )
    # bfloat16 has 8 binary digits: rounding does more than another order of a sum.
    step = (weights["bfloat16"] - weights["float32"]).abs().max()
    assert step > 1e-5


def test_bfloat16_stays_inside_of_the_networks():
    agent = make_tqc(TQCConfig(hidden_sizes=(16,), precision="bfloat16"), GymEnv("Pendulum-v1"))
    layers, losses = [], []
    for layer in agent.actor.modules():
        if isinstance(layer, torch.nn.Linear):
            layer.register_forward_hook(lambda _, __, output: layers.append(output.dtype))
    agent.loss.register_forward_hook(lambda _, __, output: losses.append(output))
    batch = make_pendulum_batch(6)
    agent.update(batch)
    with pytest.raises(KeyError):
        agent.update(batch.exclude("observation"))
    assert {*layers} == {torch.bfloat16}
    assert {value.dtype for value in losses[0].values()} == {torch.float32}
    assert not torch.is_autocast_enabled("cpu")
    layers.clear()
    agent.actor(batch)
    assert {*layers} == {torch.float32}


@pytest.mark.parametrize("layer_norm", [False, True])
def test_critics_in_bfloat16_are_close_and_those_of_doubles_stay(layer_norm, monkeypatch):
    products, product = [], torch.baddbmm

    def note(*args):
        products.append(product(*args))
        return products[-1]

    monkeypatch.setattr(torch, "baddbmm", note)
    found = {}
    for dtype in (torch.float32, torch.float64):
        critic = make_critic(6, 2, 7, (16, 12), layer_norm=layer_norm).to(dtype)
        ensemble = BatchedEnsemble(critic)
        torch.manual_seed(0)
        params = TensorDict.from_module(critic).apply(
            lambda p: torch.randn(3, *p.shape, dtype=p.dtype), batch_size=[3]
        )
        inputs = [torch.randn(5, 6, dtype=dtype), torch.randn(5, 2, dtype=dtype)]
        exact = ensemble(inputs, params)
        products.clear()
        with networks_in("bfloat16"):
            found[dtype] = ensemble(inputs, params)
        assert found[dtype].dtype == dtype
        assert {value.dtype for value in products} == {
            torch.bfloat16 if dtype == torch.float32 else torch.float64
        }
        if dtype == torch.float64:
            assert torch.equal(found[dtype], exact)
        else:
            torch.testing.assert_close(found[dtype], exact, rtol=0.05, atol=0.5)


def test_auto_is_the_precision_that_the_processor_has_instructions_for(monkeypatch):
    for found, expected in ({"amx_bf16": True}, "bfloat16"), ({"avx512": True}, "float32"):
        monkeypatch.setattr(torch.cpu, "get_capabilities", lambda found=found: found)
        agent = make_tqc(TQCConfig(precision="auto"), GymEnv("Pendulum-v1"))
        assert (agent.config.precision, agent.update.precision) == (expected, expected)


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
