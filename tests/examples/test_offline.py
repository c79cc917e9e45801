"""`examples/offline.py`: every method learns a little and leaves an agent's file."""

from pathlib import Path

import pytest

from modpush.data import CollectConfig, collect_demonstrations
from modpush.recipes import PushEnvConfig, load_agent
from tests.examples import load_example


# TorchRL's own, about its IQL loss.
@pytest.mark.filterwarnings("ignore:The name \\w+ wasn't part of the annotations:UserWarning")
def test_every_method_leaves_an_agent(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    env = PushEnvConfig.preset("cpu", num_envs=2, encoder="rays", max_episode_steps=20)
    data = CollectConfig(policy=("scripted",), episodes=3, env=env, out=tmp_path / "data")
    collect_demonstrations(data, progress=False)
    offline = load_example("offline")
    config = offline.Config(
        data=tmp_path / "data",
        method=("bc", "iql", "cql"),
        updates=3,
        batch_size=16,
        hidden_sizes=(16,),
        episodes=2,
        out=tmp_path / "agents",
    )
    results = offline.main(config)
    assert set(results) == {"bc", "iql", "cql"}
    assert "bc: success" in capsys.readouterr().out
    for method in results:
        agent = load_agent(tmp_path / "agents" / f"{method}.safetensors")
        assert agent.metadata["method"] == method
        assert agent.config.encoder == "rays"
