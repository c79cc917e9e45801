"""Agents on the Hub, against a server in this process that speaks the part of its API that is used."""

import base64
import hashlib
import json
import threading
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

import huggingface_hub
import pytest
import torch

from modpush.recipes import load_agent, push_to_hub
from modpush.recipes.methods import get_method

COMMIT = "0123456789abcdef0123456789abcdef01234567"


class Hub(ThreadingHTTPServer):
    """A hub with the repositories that were pushed to it."""

    def __init__(self) -> None:
        super().__init__(("127.0.0.1", 0), Handler)
        self.repositories: dict[str, dict[str, bytes]] = {}

    @property
    def address(self) -> str:
        return f"http://127.0.0.1:{self.server_port}"


class Handler(BaseHTTPRequestHandler):
    server: Hub

    def log_message(self, *args: object) -> None:
        pass

    def answer(self, content: object, status: int = 200, **headers: str) -> None:
        body = content if isinstance(content, bytes) else json.dumps(content).encode()
        self.send_response(status)
        for name, value in {"Content-Length": str(len(body)), **headers}.items():
            self.send_header(name.replace("_", "-"), value)
        self.end_headers()
        if self.command != "HEAD":
            self.wfile.write(body)

    def do_POST(self) -> None:
        body = self.rfile.read(int(self.headers["Content-Length"]))
        path = self.path.partition("?")[0]
        if path == "/api/repos/create":
            asked = json.loads(body)
            name = f"{asked['organization']}/{asked['name']}"
            self.server.repositories.setdefault(name, {})
            self.answer({"url": f"{self.server.address}/{name}"})
        elif path == "/api/validate-yaml":
            self.answer({"errors": [], "warnings": []})
        elif "/preupload/" in path:
            files = [
                {"path": f["path"], "uploadMode": "regular", "shouldIgnore": False}
                for f in json.loads(body)["files"]
            ]
            self.answer({"files": files})
        elif "/commit/" in path:
            name = path.removeprefix("/api/models/").partition("/commit/")[0]
            for line in map(json.loads, body.splitlines()):
                if line["key"] == "file":
                    content = base64.b64decode(line["value"]["content"])
                    self.server.repositories[name][line["value"]["path"]] = content
            url = f"{self.server.address}/{name}/commit/{COMMIT}"
            self.answer({"commitUrl": url, "commitOid": COMMIT})
        else:
            self.answer({"error": path}, 404)

    def do_GET(self) -> None:
        name, _, rest = self.path.removeprefix("/").partition("/resolve/")
        revision, _, file = rest.partition("/")
        content = self.server.repositories.get(name, {}).get(file)
        if content is None or revision not in ("main", COMMIT):
            self.answer({"error": "not found"}, 404, X_Error_Code="RepoNotFound")
            return
        etag = hashlib.sha256(content).hexdigest()
        self.answer(content, ETag=f'"{etag}"', X_Repo_Commit=COMMIT)

    do_HEAD = do_GET


@pytest.fixture
def hub(tmp_path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Hub]:
    server = Hub()
    threading.Thread(target=server.serve_forever, daemon=True).start()
    constants = huggingface_hub.constants
    monkeypatch.setattr(constants, "ENDPOINT", server.address)
    monkeypatch.setattr(
        constants,
        "HUGGINGFACE_CO_URL_TEMPLATE",
        server.address + "/{repo_id}/resolve/{revision}/{filename}",
    )
    monkeypatch.setattr(constants, "HF_HUB_CACHE", str(tmp_path / "cache"))
    monkeypatch.setattr(constants, "HF_HUB_DISABLE_TELEMETRY", True)
    yield server
    server.shutdown()
    server.server_close()


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
    with pytest.raises(ValueError, match="cut short or damaged"):
        load_agent("hf://someone/pusher")


def test_what_is_not_there_and_malformed_names_are_said(hub: Hub) -> None:
    with pytest.raises(OSError, match="load_agent: hf://someone/nothing cannot be read"):
        load_agent("hf://someone/nothing")
    with pytest.raises(ValueError, match="expected hf://owner/name or hf://owner/name@revision"):
        load_agent("hf://pusher")
    hub.shutdown()
    hub.server_close()
    with pytest.raises(OSError, match="load_agent: hf://someone/pusher cannot be read"):
        load_agent("hf://someone/pusher")
    agent = load_agent("small_cube")
    with pytest.raises(OSError, match="push_to_hub: someone/pusher cannot be written"):
        push_to_hub(agent, "someone/pusher", token="hf_test")
    with pytest.raises(ValueError, match="repository must be 'owner/name', got 'pusher'"):
        push_to_hub(agent, "pusher")
