"""Trained agents on disk: a policy, the configuration of its environment, and its fingerprint."""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from importlib.resources import files
from pathlib import Path
from typing import Annotated, Any

import torch
from annotated_types import Le, MaxLen
from tensordict.nn import TensorDictModuleBase
from torchrl.data import Bounded, Composite, Unbounded
from torchrl.envs import EnvBase
from torchrl.modules import ProbabilisticActor

from modpush._state import check_weights
from modpush._types import AtLeastOne, Count, Name
from modpush._validation import checked, checked_arguments, from_plain
from modpush.agents.tqc.config import TQCConfig
from modpush.agents.tqc.encoder import make_trained_encoder
from modpush.agents.tqc.factories import ACTORS, LearnerSpecs
from modpush.envs.scenes.objects import get_object
from modpush.files import read_tensors, reading, write_tensors
from modpush.mdp.stuck_recovery import StuckRecovery, recovering
from modpush.parts import check_allowed, find_part, part_name
from modpush.recipes.config import END_TO_END, PushEnvConfig
from modpush.recipes.fingerprint import environment_fingerprint, fingerprint_differences
from modpush.recipes.make_env import ENV_PARTS, env_parts, make_push_env

BEST_AGENT = "best_agent.safetensors"
"""File of the best agent in a training run's folder."""
_KIND, _VERSION = "modpush.Agent", 5


@checked
class _Network:
    """The policy's network in a file, see `save_agent`."""

    hidden_sizes: Annotated[AtLeastOne[Count], MaxLen(1000)]
    observation_dim: Annotated[Count, Le(1_000_000)]
    actor: Name
    encoder: Name | None = None
    image_key: Name = "window"


@checked
class _Part:
    """Name by which a part is found again, or a description of one that has none."""

    name: Name | None = None
    was: str | None = None


@checked
class _Content:
    """Content of an agent's file beside the weights."""

    env: PushEnvConfig
    network: _Network
    fingerprint: Mapping[str, Any]
    parts: Mapping[str, _Part]
    make_env: _Part | None
    metadata: Mapping[str, Any]


@dataclass(frozen=True, kw_only=True)
class Agent:
    """A trained policy, and the environment that it was trained in."""

    actor: ProbabilisticActor
    """The trained policy: reads `observation` and writes `action`; greedy unless TorchRL's exploration
    type says otherwise."""
    config: PushEnvConfig
    """Configuration of the environment, for `make_push_env`."""
    metadata: Mapping[str, Any]
    """Further plain data that was saved with the agent."""
    fingerprint: Mapping[str, Any] = field(default_factory=dict)
    """Fingerprint of the environment, see `environment_fingerprint`."""
    parts: Mapping[str, Any] = field(default_factory=dict)
    """Parts given as objects, by the names of `make_push_env`'s arguments."""
    factory: Callable[..., EnvBase] = make_push_env
    """Factory of the environment."""
    missing: Mapping[str, str] = field(default_factory=dict)
    """Parts that the environment needs and that were not given, with what they were."""

    @property
    def policy(self) -> TensorDictModuleBase:
        """The policy for the environment of `make_env`, with the recovery if the config says so.

        It is the actor; with `config.recovery`, `StuckRecovery` takes over when tool and object have
        come to rest.
        """
        return recovering(self.actor) if self.config.recovery else self.actor

    def make_env(self, num_envs: int | None = None, **options: Any) -> EnvBase:
        """The environment in which the agent was trained, with `StuckRecovery` if its config says so.

        Args:
            num_envs: Number of scenes; by default the config's.
            **options: Further arguments of `make_push_env`. The engine may be another one than
                that of the training, `fingerprint["engine"]`.

        Raises:
            ValueError: If a part is missing that `load_agent` was not given, or if the environment
                shows the policy other values than those of its training; the message says which.
        """
        if missing := {kind: was for kind, was in self.missing.items() if kind not in options}:
            named = ", ".join(f"{kind!r}: ..." for kind in missing if kind != "make_env")
            given = [f"parts={{{named}}}"] if named else []
            given += ["make_env=..."] if "make_env" in missing else []
            raise ValueError(
                f"Agent.make_env: this agent was trained with its user's own parts, {missing}; "
                f"pass them to load_agent as {' and '.join(given)}."
            )
        num_envs = self.config.num_envs if num_envs is None else num_envs
        symmetry = observed_symmetry(self.config, self.parts.get("pushed_object"))
        config = replace(self.config, num_envs=num_envs, symmetry=symmetry)
        env = self.factory(config, **{**env_parts(config, self.parts), **options})
        differences = fingerprint_differences(self.fingerprint, environment_fingerprint(env))
        if self.fingerprint and differences:
            env.close()
            raise ValueError(
                "Agent.make_env: this is not the environment that the agent was trained in. "
                + "; ".join(differences)
            )
        if self.config.recovery and "recovering" not in env.observation_spec.keys():
            return env.append_transform(StuckRecovery())  # a factory that does not know the field
        return env


def observed_symmetry(config: PushEnvConfig, pushed_object: Any = None) -> int | None:
    """The symmetry that an environment's observation goes by, of the config's objects or others.

    None for several objects with their own each, and where the environment itself says that no two yaw
    angles look the same.
    """
    trained = config.scenario.pushed_object if pushed_object is None else pushed_object
    several = trained if isinstance(trained, list | tuple) else (trained,)
    if config.symmetry is not None or len(several) > 1 or config.simulation.full_circle:
        return config.symmetry
    return get_object(several[0]).symmetry


@checked_arguments
def save_agent(
    path: str | Path,
    policy: TensorDictModuleBase,
    config: PushEnvConfig,
    *,
    hidden_sizes: Sequence[Count],
    observation_dim: Count,
    fingerprint: Mapping[str, Any],
    actor: str = "mlp",
    encoder: str | None = None,
    image_key: str = "window",
    parts: Mapping[str, Any] | None = None,
    make_env: Callable[..., EnvBase] = make_push_env,
    metadata: Mapping[str, Any] | None = None,
) -> None:
    """Write a policy and its environment's config as one safetensors file, atomically.

    Args:
        path: The file to write.
        policy: The policy, as `make_actor` makes it.
        config: Configuration of the environment in which it was trained.
        hidden_sizes: Widths of the policy network's hidden layers.
        observation_dim: Width of its observation.
        fingerprint: `environment_fingerprint` of the environment in which it was trained.
        actor: Network of the policy, as in `TQCConfig.actor`.
        encoder: Image encoder inside the policy, as in `TQCConfig.encoder`.
        image_key: Key of the encoder's images, as in `TQCConfig.image_key`.
        parts: Parts that were given as objects. Those that can be imported are stored as
            `"module:name"`, the others by a description.
        make_env: Function that made the environment, stored in the same way.
        metadata: Further data to store, ready for JSON.

    Raises:
        TypeError: If the policy is not a TensorDict module, or fingerprint or metadata not for JSON.
        ValueError: If an argument is of another type or out of its range.
    """
    content = _Content(
        env=config,
        network=_Network(
            hidden_sizes=tuple(hidden_sizes),
            observation_dim=observation_dim,
            actor=actor,
            encoder=encoder,
            image_key=image_key,
        ),
        fingerprint=fingerprint,
        parts={
            kind: _describe(part)
            for kind, part in (parts or {}).items()
            if kind in (*ENV_PARTS, "actor")  # others matter in training only
        },
        make_env=None if make_env is make_push_env else _describe(make_env),
        metadata=metadata or {},
    )
    write_tensors(path, policy.state_dict(), _KIND, _VERSION, asdict(content))


def _describe(part: Any) -> _Part:
    try:
        return _Part(name=part_name("save_agent", part, {}))
    except ValueError:
        if isinstance(part, Mapping):  # terms of the reward by name
            return _Part(was=f"a mapping of {sorted(map(str, part))}")
        named = part if hasattr(part, "__qualname__") else type(part)  # of a notebook or a closure
        return _Part(was=f"{named.__module__}:{named.__qualname__}")


def shipped_agents() -> dict[str, Path]:
    """Files of the agents that come with the library, by name."""
    folder = Path(str(files("modpush").joinpath("weights")))
    found = sorted(folder.glob("agent_*.safetensors"))
    return {path.stem.removeprefix("agent_"): path for path in found}


@checked_arguments
def load_agent(
    name: str | Path,
    *,
    parts: Mapping[str, Any] | None = None,
    make_env: Callable[..., EnvBase] | None = None,
    allow: Collection[str] = (),
) -> Agent:
    """Load a trained agent: a shipped one, a file of `save_agent`, or that of a run.

    A file may name its author's own parts, `"module:name"`. They are imported only from modules
    that the caller names in `allow`, since importing runs code; or the caller passes the parts.

    Args:
        name: `"small_cube"`, the path of a file, or the folder of a training run, of which the best agent
            is read.
        parts: Parts of the environment by the names of `make_push_env`'s arguments, instead of those
            that the file names.
        make_env: Function that makes the environment, instead of the one that the file names.
        allow: Modules and packages from which parts may be imported.

    Raises:
        ValueError: If there is no such agent (the message lists the shipped ones), or if the file
            is damaged, not an agent, names modules that are not allowed, or its weights do not fit
            its config or are not finite.
    """
    path = _find_file(name)
    with reading(path, _KIND):
        tensors, about = read_tensors(path, _KIND, _VERSION)
        content = from_plain(_Content, about)
    given = {**(parts or {}), **({} if make_env is None else {"make_env": make_env})}
    own = {**content.parts, **({"make_env": content.make_env} if content.make_env else {})}
    own = {kind: part for kind, part in own.items() if kind not in given}
    named = {kind: part.name for kind, part in own.items() if part.name is not None}
    missing = {kind: part.was or "" for kind, part in own.items() if part.name is None}
    config, network = content.env, content.network
    if "actor" in given:
        network = replace(network, actor="mlp")
    if "encoder" in given and config.encoder == END_TO_END:
        network = replace(network, encoder=None)
    in_config = _without(asdict(config), given)
    check_allowed(f"load_agent: {path}", [named, in_config, asdict(network)], allow)
    found = {kind: find_part(f"load_agent: {kind}", text, {}) for kind, text in named.items()}
    found |= given
    needed = ("actor", "encoder") if config.encoder == END_TO_END else ("actor",)
    if lacking := {kind: missing[kind] for kind in needed if kind in missing}:
        raise ValueError(
            f"load_agent: the policy in {path} is made of parts that no file can name, {lacking}; "
            f"give them as parts={{{', '.join(f'{kind!r}: ...' for kind in lacking)}}}."
        )
    return Agent(
        actor=_actor(path, network, config, found, tensors),
        config=config,
        metadata=content.metadata,
        fingerprint=content.fingerprint,
        factory=found.pop("make_env", make_push_env),
        parts=found,
        missing=missing,
    )


def _without(config: Mapping[str, Any], kinds: Collection[str]) -> dict[str, Any]:
    """A config as plain data without the fields of these names, wherever they are."""
    return {
        name: _without(value, kinds) if isinstance(value, Mapping) else value
        for name, value in config.items()
        if name not in kinds
    }


def _find_file(name: str | Path) -> Path:
    path = shipped_agents().get(str(name), Path(name))
    if (path / BEST_AGENT).is_file():
        path = path / BEST_AGENT
    if not path.is_file():
        raise ValueError(
            f"load_agent: no agent {str(name)!r}, expected one of {sorted(shipped_agents())}, an agent's "
            "file, or a training run's folder."
        )
    return path


def _actor(
    path: Path,
    network: _Network,
    config: PushEnvConfig,
    parts: Mapping[str, Any],
    tensors: Mapping[str, torch.Tensor],
) -> ProbabilisticActor:
    """Build the network that the file describes, and put the weights into it."""
    encoder = network.encoder
    if config.encoder == END_TO_END:
        encoder = parts.get("encoder", encoder)
    side, image_key = config.window_size, network.image_key
    observation = Composite(observation=Unbounded((network.observation_dim,)))
    observation[image_key] = Bounded(0, 255, (1, side, side), dtype=torch.uint8)
    specs = LearnerSpecs(
        observation=observation,
        image_key=image_key,
        action=Bounded(-1.0, 1.0, (3,), dtype=torch.float32),
        encoder=None if encoder is None else make_trained_encoder(encoder),
    )
    factory = find_part("actor", parts.get("actor", network.actor), ACTORS)
    learner = TQCConfig(hidden_sizes=network.hidden_sizes)
    # Whatever the process's default dtype is, the policy's is that of the file's weights.
    double = {tensor.dtype for tensor in tensors.values()} == {torch.float64}
    dtype = torch.float64 if double else torch.float32
    if factory in ACTORS.values():  # without memory at first: a file may ask for any sizes
        with reading(path, _KIND):
            planned = factory(replace(learner, device="meta"), specs).to(dtype)
            check_weights(path, planned.state_dict(), tensors)
    policy = factory(learner, specs).to(dtype)
    check_weights(path, policy.state_dict(), tensors)
    policy.load_state_dict(tensors)
    return policy.eval().requires_grad_(False)
