"""Agents on the Hub, against a server in this process that speaks the part of its API that is used."""

from collections.abc import Iterator
from pathlib import Path

import pytest
import torch

from modpush.recipes import load_agent, shipped_agents
from modpush.recipes.methods import get_method
from tests.hub_server import COMMIT, Hub, serve_hub

CONTENT = shipped_agents()["small_cube"].read_bytes()


@pytest.fixture
def hub(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Hub]:
    with serve_hub(tmp_path / "cache", monkeypatch) as server:
        yield server


def test_an_agent_is_read_from_the_hub(hub: Hub) -> None:
    hub.repositories["someone/pusher"] = {"agent.safetensors": CONTENT}
    agent, there = load_agent("small_cube"), load_agent("hf://someone/pusher")
    for name, value in agent.policy.state_dict().items():
        assert torch.equal(there.policy.state_dict()[name], value)
    assert (there.config, there.fingerprint) == (agent.config, agent.fingerprint)
    assert load_agent(f"hf://someone/pusher@{COMMIT}").config == agent.config
    assert get_method("hf://someone/pusher").name == "someone_pusher"


def test_a_damaged_file_on_the_hub_is_refused(hub: Hub) -> None:
    content = CONTENT[:-1] + bytes([CONTENT[-1] ^ 1])
    hub.repositories["someone/pusher"] = {"agent.safetensors": content}
    with pytest.raises(ValueError, match="checksum"):
        load_agent("hf://someone/pusher")
