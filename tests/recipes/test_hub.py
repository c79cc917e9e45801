"""Agents on the Hub, against a server in this process that speaks the part of its API that is used."""

from collections.abc import Iterator
from pathlib import Path

import pytest
import torch

from modpush.recipes import load_agent, push_to_hub
from modpush.recipes.methods import get_method
from tests.hub_server import COMMIT, Hub, serve_hub


@pytest.fixture
def hub(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Hub]:
    with serve_hub(tmp_path / "cache", monkeypatch) as server:
        yield server


def test_an_agent_comes_back_from_the_hub_as_it_was(hub: Hub) -> None:
    agent = load_agent("small_cube")
    url = push_to_hub(agent, "someone/pusher", token="hf_test")
    assert url == f"{hub.address}/someone/pusher/commit/{COMMIT}"
    files = hub.repositories["someone/pusher"]
    assert agent.source is not None
    assert files["agent.safetensors"] == agent.source.read_bytes()
    card = files["README.md"].decode()
    assert "library_name: modpush" in card
    assert 'modpush.load_agent("hf://someone/pusher")' in card
    again = load_agent("hf://someone/pusher")
    for name, value in agent.policy.state_dict().items():
        assert torch.equal(again.policy.state_dict()[name], value)
    assert again.config == agent.config
    assert again.fingerprint == agent.fingerprint
    assert load_agent(f"hf://someone/pusher@{COMMIT}").config == agent.config
    method = get_method("hf://someone/pusher")
    assert method.name == "someone_pusher"


def test_a_damaged_file_on_the_hub_is_refused(hub: Hub) -> None:
    agent = load_agent("small_cube")
    push_to_hub(agent, "someone/pusher", token="hf_test", card="# mine\n")
    files = hub.repositories["someone/pusher"]
    assert files["README.md"] == b"# mine\n"
    content = bytearray(files["agent.safetensors"])
    content[-1] ^= 1
    files["agent.safetensors"] = bytes(content)
    with pytest.raises(ValueError, match="checksum"):
        load_agent("hf://someone/pusher")
