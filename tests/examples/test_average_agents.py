"""`average_agents.py`: the mean of weights, from files and from a run's checkpoints."""

from dataclasses import replace
from pathlib import Path

import torch

from modpush import load_agent
from modpush.recipes import save_agent
from modpush.recipes.agent_file import shipped_agents
from modpush.training import Trainer
from tests.examples import load_example
from tests.training.conftest import SHORT

EXAMPLE = load_example("average_agents")


def test_the_mean_of_two_files_with_another_config(tmp_path: Path) -> None:
    source = shipped_agents()["pose"]
    agent = load_agent("pose")
    shifted = agent.actor.requires_grad_(False)
    for weights in shifted.parameters():
        weights += 1.0
    sizes = EXAMPLE.hidden_sizes(agent)
    assert sizes == (256, 256)
    dims = next(shifted.parameters()).shape[1]
    save_agent(
        tmp_path / "other.safetensors",
        shifted,
        agent.config,
        hidden_sizes=sizes,
        observation_dim=dims,
        fingerprint=agent.fingerprint,
    )
    out = tmp_path / "mean.safetensors"
    changes = [("motion_ahead", "1.0")]
    EXAMPLE.main([source, tmp_path / "other.safetensors"], out, [], changes)
    mean = load_agent(out)
    assert mean.config == agent.config.with_fields(motion_ahead=1.0)
    assert mean.metadata["mean_of"] == [str(source), str(tmp_path / "other.safetensors")]
    before = load_agent("pose").actor.state_dict()
    for name, weights in mean.actor.state_dict().items():
        torch.testing.assert_close(weights, before[name] + 0.5)


def test_the_mean_of_a_runs_checkpoints(tmp_path: Path) -> None:
    Trainer(replace(SHORT, checkpoint_every=48), tmp_path / "run").run()
    steps = [int(path.stem[5:]) for path in sorted((tmp_path / "run" / "checkpoints").iterdir())]
    weights = [EXAMPLE.weights_at(tmp_path / "run", n) for n in steps]
    out = tmp_path / "mean.safetensors"
    EXAMPLE.main([tmp_path / "run"], out, steps, [])
    for name, value in load_agent(out).actor.state_dict().items():
        torch.testing.assert_close(value, torch.stack([w[name] for w in weights]).mean(0))
    last = load_agent(tmp_path / "run" / "last_agent.safetensors").actor.state_dict()
    for name, value in weights[-1].items():
        assert torch.equal(value, last[name])
