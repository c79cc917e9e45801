"""The paper's system, put together from the parts of all rooms.

`make_push_env` stacks the paper's transforms on a `PushEnv`: a `Compose` that anyone can rebuild by
hand. `load_agent` gives a trained policy with the configuration of the environment that it needs.
"""

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from importlib.resources import files
from pathlib import Path
from typing import Any, Literal, TypeVar

import dacite
import safetensors
import safetensors.torch
import torch
from tensordict.nn import TensorDictModuleBase
from torch import nn
from torchrl.data import Bounded
from torchrl.envs import Compose, EnvBase, ExcludeTransform, InitTracker, Transform, TransformedEnv
from torchrl.modules import ProbabilisticActor

from modpush.agents.tqc.networks import make_actor
from modpush.encoders import DepthVAE, EgocentricWindow, Encode, RayScan
from modpush.envs.push_env import PushEnv
from modpush.envs.scenes.layouts import OBSTACLE_SCENES
from modpush.envs.scenes.objects import get_object
from modpush.geometry.frames import Frame
from modpush.mdp.action_frame import ActionFrame
from modpush.mdp.blank_latent import latent_entry
from modpush.mdp.curriculum import Curriculum
from modpush.mdp.curriculum_scenes import CurriculumScenes
from modpush.mdp.entry_list import resolve_entries
from modpush.mdp.observation_entries import ENTRIES, EntryLike
from modpush.mdp.push_observation import PushObservation
from modpush.mdp.push_reward import PushReward, RewardConfig
from modpush.mdp.reward_terms import RewardTerm
from modpush.planners import PLANNERS, OccupancyGrid, Planner, PlannerSubgoals
from modpush.planners.subgoals import SubgoalMode

__all__ = ["Agent", "PushEnvConfig", "load_agent", "make_push_env", "save_agent"]

_IMAGES = ("depth", "segmentation", "occupancy", "window")
_FOR_PUSH_ENV = (
    *("num_envs", "scene", "pushed_object", "difficulty", "distance", "max_episode_steps"),
    *("oob", "tool", "sim_freq", "depth", "randomize_dynamics"),
)
"""Fields of `PushEnvConfig` that are arguments of `PushEnv`."""
_FORMAT = "modpush-agent-2"
T = TypeVar("T")


@dataclass(frozen=True, kw_only=True)
class PushEnvConfig:
    """The paper's environment; the defaults are the paper's, `preset("cpu")` what learns in minutes."""

    num_envs: int = 8
    """Scenes stepped together."""
    pushed_object: str = "small_cube"
    """Name of what is pushed."""
    scene: tuple[str, ...] = ("free", *OBSTACLE_SCENES)
    """Scene families, one drawn an episode; a curriculum replaces them."""
    difficulty: tuple[float, float] = (0.0, 1.0)
    """Of the scenes."""
    distance: tuple[float, float] = (0.2, 0.6)
    """From start to goal [m]."""
    frame: Frame = "object"
    """Axes in which the agent sees and acts, and of the window."""
    action_frame: Frame | None = None
    """Axes in which it acts, if others than `frame` (the paper: `"base"`)."""
    encoder: str = "vae"
    """`"vae"` (the one that is shipped), `"rays"`, `"none"`, or the file of a trained `DepthVAE`."""
    planner: str = "distance_field"
    """One of `PLANNERS`; `"distance_field"` gives Lazy Theta*'s paths, faster."""
    subgoal_mode: SubgoalMode = "fraction"
    """See `PlannerSubgoals`."""
    subgoal_fraction: float = 0.2
    """Of the path's length."""
    subgoal_lookahead: float = 0.2
    """For the mode `"lookahead"` [m]."""
    reward: RewardConfig = field(default_factory=RewardConfig)
    """Weights, scale and normalisation."""
    raw: bool = False
    """Observe SI units instead of values scaled to order 1."""
    max_episode_steps: int = 200
    """Control steps."""
    oob: Literal["truncate", "terminate"] = "truncate"
    """What leaving the workspace does."""
    tool: Literal["2f85", "rod"] = "2f85"
    """What pushes."""
    sim_freq: int = 120
    """Physics steps a second."""
    depth: Literal["analytic", "sapien"] = "analytic"
    """Depth camera: cast from the known shapes, or rendered by SAPIEN."""
    randomize_dynamics: bool = False
    """Draw mass, friction and centre of mass per episode."""

    def __post_init__(self) -> None:
        """Check the names; numbers are checked by the parts that take them."""
        get_object(self.pushed_object)
        if self.planner not in PLANNERS:
            raise ValueError(
                f"PushEnvConfig: planner must be one of {sorted(PLANNERS)}, got {self.planner!r}."
            )
        known = ("vae", "rays", "none")
        if self.encoder not in known and not Path(self.encoder).is_file():
            raise ValueError(
                f"PushEnvConfig: encoder must be one of {known} or a file, got {self.encoder!r}."
            )

    @classmethod
    def preset(cls, name: Literal["paper", "cpu"], **overrides: Any) -> "PushEnvConfig":
        """A named set of values, with single fields overridden.

        Args:
            name: `"paper"`: the object's frame, the agent acts in the base's. `"cpu"`: the path's
                frame, which is learned in a fraction of the time.
            **overrides: Fields to set differently.

        Raises:
            ValueError: If there is no such preset.
        """
        if name not in _PRESETS:
            raise ValueError(
                f"PushEnvConfig: preset must be one of {sorted(_PRESETS)}, got {name!r}."
            )
        return replace(cls(**_PRESETS[name]), **overrides)


_PRESETS: dict[str, dict[str, Any]] = {
    "paper": {"frame": "object", "action_frame": "base"},
    "cpu": {
        "frame": "path",
        "subgoal_mode": "lookahead",
        # Milder on collisions than the paper: at its 5 and 2 a young policy stops beside obstacles.
        "reward": RewardConfig(
            normalisation="constant",
            weights={**RewardConfig().weights, "object_collision": 1.5, "tool_collision": 0.5},
        ),
        "num_envs": 16,
    },
}


def make_push_env(
    config: PushEnvConfig | None = None,
    *,
    encoder: nn.Module | None = None,
    planner: Planner | str | None = None,
    entries: Sequence[EntryLike | tuple[str, EntryLike]] | None = None,
    reward_terms: Mapping[str, RewardTerm | str] | None = None,
    curriculum: Curriculum | None = None,
    evaluated_envs: Sequence[int] | None = None,
    max_waypoints: int = 0,
    keep_images: bool = False,
    seed: int | None = None,
    **options: Any,
) -> EnvBase:
    """The paper's stack of transforms on a `PushEnv`, batch size `[num_envs]`.

    It emits what `PushEnv` does, without the images, and `path_length`, `subgoal`, `subgoal_past`,
    `path_found` (see `PlannerSubgoals`), `latent` `[B, d]`, `observation` `[B, n]` float32,
    `reward` `[B, 1]` and its terms under `reward_terms`.

    Args:
        config: What is stacked; the paper's by default.
        encoder: Encodes the window, instead of what the config names.
        planner: Plans, instead of what the config names.
        entries: Of the observation, see `PushObservation`; by default the frame's. From
            `"latent"` the encoder's latent of an empty table is taken off.
        reward_terms: Terms of yours; give each a weight in `config.reward`.
        curriculum: Says which episodes are drawn.
        evaluated_envs: Scenes whose episodes count for the curriculum, see `CurriculumScenes`.
        max_waypoints: Emit `path`, too, see `PlannerSubgoals`.
        keep_images: Emit depth, segmentation, occupancy and window, too.
        seed: Of the first scene, see `PushEnv`.
        **options: Further arguments of `PushEnv`, before those of the config.

    Raises:
        ValueError: If a part refuses its settings.
    """
    config = config or PushEnvConfig()
    settings = {name: getattr(config, name) for name in _FOR_PUSH_ENV}
    base = PushEnv(**{**settings, "seed": seed, **options})
    transforms: list[Transform] = [InitTracker()]
    if curriculum is not None:
        transforms.append(CurriculumScenes(curriculum, evaluated_envs=evaluated_envs))
    transforms += [
        OccupancyGrid(object_radius_key="object_radius"),
        PlannerSubgoals(
            planner if planner is not None else config.planner,
            mode=config.subgoal_mode,
            fraction=config.subgoal_fraction,
            lookahead=config.subgoal_lookahead,
            max_waypoints=max_waypoints,
        ),
    ]
    encoder = encoder if encoder is not None else _make_encoder(config.encoder)
    if encoder is not None:
        transforms += [EgocentricWindow(config.frame), Encode(encoder)]
    left_out = ("latent",) if entries is None and encoder is None else ()
    found = resolve_entries(config.frame, entries, leave_out=left_out)
    if encoder is not None and found.get("latent") is ENTRIES["latent"]:
        found["latent"] = latent_entry(encoder)
    transforms += [
        ActionFrame(config.frame if config.action_frame is None else config.action_frame),
        PushObservation(config.frame, entries=found, bounds=base.bounds, raw=config.raw),
        PushReward(config.reward, terms=reward_terms),
    ]
    if not keep_images:
        images = _IMAGES if encoder is not None else _IMAGES[:-1]
        transforms.append(ExcludeTransform(*images))
    return TransformedEnv(base, Compose(*transforms))


def _make_encoder(name: str) -> nn.Module | None:
    if name == "none":
        return None
    if name == "rays":
        return RayScan()
    return DepthVAE.from_pretrained() if name == "vae" else DepthVAE.from_pretrained(name)


@dataclass(frozen=True)
class Agent:
    """A trained policy, and the environment that it was trained for."""

    policy: ProbabilisticActor
    """Reads `observation`, writes `action`; greedy unless an exploration type says otherwise."""
    config: PushEnvConfig
    """Of `make_push_env`."""
    metadata: Mapping[str, Any]
    """What else was saved with it."""

    def make_env(self, num_envs: int | None = None, **options: Any) -> EnvBase:
        """`make_push_env` with this agent's config."""
        num_envs = self.config.num_envs if num_envs is None else num_envs
        return make_push_env(replace(self.config, num_envs=num_envs), **options)


def save_agent(
    path: str | Path,
    policy: TensorDictModuleBase,
    config: PushEnvConfig,
    *,
    hidden_sizes: Sequence[int],
    observation_dim: int,
    metadata: Mapping[str, Any] | None = None,
) -> None:
    """Write a policy and its environment's config as one safetensors file, whole or not at all.

    Args:
        path: Of the file.
        policy: From `make_actor`.
        config: Of the environment that it was trained for.
        hidden_sizes: Of its network.
        observation_dim: Width of its observation.
        metadata: What else to keep, ready for JSON.
    """
    header = {
        "format": _FORMAT,
        "env": json.dumps(asdict(config)),
        "network": json.dumps(
            {"hidden_sizes": list(hidden_sizes), "observation_dim": observation_dim}
        ),
        "metadata": json.dumps(dict(metadata or {})),
    }
    tensors = {name: value.contiguous() for name, value in policy.state_dict().items()}
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    partial = path.with_suffix(".partial")
    safetensors.torch.save_file(tensors, partial, metadata=header)
    partial.replace(path)


def load_agent(name: str | Path) -> Agent:
    """A trained agent: one that is shipped, by the name of its object, or a file of `save_agent`.

    Args:
        name: `"small_cube"`, or a path.

    Raises:
        ValueError: If there is no such agent, with the list of those that are shipped; or if the
            file is truncated, no agent, or its weights do not fit its config.
    """
    shipped = {
        entry.name.removeprefix("agent_").removesuffix(".safetensors"): entry
        for entry in files("modpush").joinpath("weights").iterdir()
        if entry.name.startswith("agent_") and entry.name.endswith(".safetensors")
    }
    path = Path(str(shipped[str(name)])) if str(name) in shipped else Path(name)
    if not path.is_file():
        raise ValueError(
            f"load_agent: no agent {str(name)!r}, expected a file or one of {sorted(shipped)}."
        )
    try:
        with safetensors.safe_open(path, framework="pt") as file:
            header = file.metadata() or {}
            tensors = {key: file.get_tensor(key) for key in file.keys()}
    except safetensors.SafetensorError as error:
        raise ValueError(
            f"load_agent: {path} is not a whole safetensors file ({error})."
        ) from error
    if header.get("format") != _FORMAT:
        raise ValueError(
            f"load_agent: {path} is of format {header.get('format')!r}, expected {_FORMAT!r}; an "
            "agent of an earlier format sees other values and has to be trained anew."
        )
    config = config_from_dict(PushEnvConfig, json.loads(header["env"]))
    action_spec = Bounded(-1.0, 1.0, (3,), dtype=torch.float32)
    network = json.loads(header["network"])
    policy = make_actor(network["observation_dim"], action_spec, network["hidden_sizes"])
    try:
        policy.load_state_dict(tensors)
    except RuntimeError as error:
        raise ValueError(
            f"load_agent: the weights in {path} do not fit its config: {error}"
        ) from error
    policy.eval().requires_grad_(False)
    return Agent(policy, config, json.loads(header["metadata"]))


def config_from_dict(kind: type[T], data: Mapping[str, Any]) -> T:
    """A config dataclass from what `asdict` made of it, after a way through JSON or YAML.

    Raises:
        ValueError: If a field is unknown or of another type; the message names it.
    """
    try:
        return dacite.from_dict(kind, data, config=dacite.Config(cast=[tuple], strict=True))
    except dacite.DaciteError as error:
        raise ValueError(f"{kind.__name__}: {error}") from error
