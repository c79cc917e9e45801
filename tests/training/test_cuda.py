"""Training on CUDA. Skipped where there is no CUDA device."""

from dataclasses import replace
from pathlib import Path

import pytest
import torch

from modpush._extras import warn_experimental
from modpush.agents import TQCConfig, make_tqc_from_specs
from modpush.envs import PushEnv
from modpush.recipes import load_agent
from modpush.replay import ReplayConfig
from modpush.training import TRAIN_PRESETS, Trainer

SMOKE = TRAIN_PRESETS["smoke"]
on_cuda = [
    pytest.mark.gpu,
    pytest.mark.skipif(not torch.cuda.is_available(), reason="no CUDA device"),
]


@pytest.mark.parametrize(
    ("execution", "replay_device"),
    [
        pytest.param("eager", "cpu", marks=on_cuda),
        pytest.param("compile", "cuda", marks=on_cuda),
        pytest.param("cudagraph", "cuda", marks=on_cuda),
    ],
)
def test_a_run_on_cuda_leaves_an_agent_for_the_cpu(
    tmp_path: Path, execution: str, replay_device: str
) -> None:
    config = replace(
        SMOKE,
        tqc=replace(SMOKE.tqc, device="cuda", execution=execution),
        replay=ReplayConfig(batch_size=16, capacity=10_000, device=replay_device),
    )
    Trainer(config, tmp_path / "run").run()
    agent = load_agent(tmp_path / "run" / "last_agent.safetensors")
    assert {p.device.type for p in agent.policy.parameters()} == {"cpu"}
    assert all(p.isfinite().all() for p in agent.policy.parameters())


@pytest.mark.skipif(torch.cuda.is_available(), reason="there is a CUDA device")
def test_the_learner_warns_that_it_is_experimental_there() -> None:
    warn_experimental.cache_clear()
    env = PushEnv(1, depth=None)
    specs = env.full_observation_spec_unbatched, env.full_action_spec_unbatched["action"]
    with (
        pytest.warns(UserWarning, match="The learner on CUDA is experimental"),
        pytest.raises((AssertionError, RuntimeError), match="CUDA"),
    ):
        make_tqc_from_specs(TQCConfig(device="cuda"), *specs, observation_key="ee_pose")
    env.close()
