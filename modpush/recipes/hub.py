"""Agents on the Hugging Face Hub: `push_to_hub`, and what `load_agent("hf://...")` reads."""

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import modpush
from modpush._extras import require_extra
from modpush._types import Name
from modpush._validation import checked_arguments
from modpush.recipes.agent_file import HUB_PREFIX, Agent

_FILE = "agent.safetensors"
_ADDRESS = re.compile(r"hf://(?P<repo>[\w.-]+/[\w.-]+)(@(?P<revision>[\w./-]+))?")


def download_agent(address: str) -> Path:
    """The file of an agent on the Hub, from the Hub's cache on this machine if it is there.

    Args:
        address: `"hf://owner/name"`, or `"hf://owner/name@revision"`.

    Raises:
        ValueError: If the address is malformed.
        MissingExtraError: If huggingface_hub is not installed.
        OSError: If the Hub cannot be reached, or has no such agent.
    """
    found = _ADDRESS.fullmatch(address)
    if found is None:
        raise ValueError(
            f"load_agent: expected hf://owner/name or hf://owner/name@revision, got {address!r}."
        )
    require_extra(f"load_agent: {address}", "huggingface_hub")
    from huggingface_hub import hf_hub_download
    from huggingface_hub.errors import HfHubHTTPError, LocalEntryNotFoundError

    try:
        return Path(hf_hub_download(found["repo"], _FILE, revision=found["revision"]))
    except (HfHubHTTPError, LocalEntryNotFoundError) as error:  # the second: nobody listens
        raise OSError(f"load_agent: {address} cannot be read: {error}") from error


@checked_arguments
def push_to_hub(
    agent: Agent,
    repository: Name,
    *,
    card: str | None = None,
    licence: Name = "mit",
    private: bool = False,
    message: Name = "Upload a modpush agent",
    token: str | None = None,
) -> str:
    """Upload an agent's file and a card to the Hugging Face Hub, as one commit.

    `load_agent("hf://<repository>")` reads it. The Hub's address is huggingface_hub's, which the
    environment variable `HF_ENDPOINT` changes.

    Args:
        agent: An agent of `load_agent`.
        repository: `"owner/name"`; made if it is not there.
        card: The card in Markdown; by default `model_card`.
        licence: Licence that the default card names.
        private: Make a new repository private.
        message: Message of the commit.
        token: Access token; by default the one that huggingface_hub knows.

    Returns:
        Address of the commit.

    Raises:
        ValueError: If the repository's name is malformed, or the agent was not read from a file.
        MissingExtraError: If huggingface_hub is not installed.
        OSError: If the Hub cannot be reached or refuses.
    """
    if _ADDRESS.fullmatch(f"{HUB_PREFIX}{repository}") is None or "@" in repository:
        raise ValueError(f"push_to_hub: repository must be 'owner/name', got {repository!r}.")
    if agent.source is None:
        raise ValueError(
            "push_to_hub: the agent was not read from a file; write it with save_agent and read it "
            "with load_agent."
        )
    require_extra("push_to_hub", "huggingface_hub")
    from huggingface_hub import CommitOperationAdd, HfApi
    from huggingface_hub.errors import HTTPError  # its HTTP library's: also where nobody listens

    text = model_card(agent, repository, licence) if card is None else card
    api = HfApi(token=token, library_name="modpush", library_version=modpush.__version__)
    try:
        api.create_repo(repository, private=private, exist_ok=True)
        commit = api.create_commit(
            repository,
            [
                CommitOperationAdd(_FILE, agent.source.read_bytes()),
                CommitOperationAdd("README.md", text.encode()),
            ],
            commit_message=message,
        )
    except HTTPError as error:
        raise OSError(f"push_to_hub: {repository} cannot be written: {error}") from error
    return str(commit.commit_url)


@checked_arguments
def model_card(agent: Agent, repository: Name, licence: Name = "mit") -> str:
    """A card for the Hub: what the agent observes, how it acts, and how it is used.

    Args:
        agent: The agent.
        repository: Its `"owner/name"`.
        licence: Licence of the weights.
    """
    config = agent.config
    entries = agent.fingerprint.get("observation", {}).get("entries", [])
    return "\n".join(
        [
            "---",
            f"license: {licence}",
            "library_name: modpush",
            "pipeline_tag: reinforcement-learning",
            "tags: [robotics, pushing, ur5, torchrl]",
            "---",
            f"# {repository}",
            "",
            "A policy that pushes an object through clutter to a goal with a UR5 arm, for modpush.",
            "",
            "```python",
            "import modpush",
            "",
            f'agent = modpush.load_agent("{HUB_PREFIX}{repository}")',
            "env = agent.make_env(num_envs=4, seed=0)",
            "rollout = env.rollout(100, agent.policy, break_when_any_done=False)",
            "env.close()",
            "```",
            "",
            f"- object: {', '.join(config.scenario.pushed_object)}",
            f"- frame: {config.frame}; encoder: {config.encoder}; planner: {config.planner}",
            f"- observation: {', '.join(str(entry['name']) for entry in entries) or 'unknown'}",
            f"- written with modpush {modpush.__version__}",
            *_metadata_lines(agent.metadata),
            "",
        ]
    )


def _metadata_lines(metadata: Mapping[str, Any]) -> list[str]:
    """Metadata of the agent, where it is short enough to be read."""
    return [
        f"- {name}: {value}"
        for name, value in metadata.items()
        if isinstance(value, str | int | float)
    ]
