"""Everything that defines a training run, and your own parts in it."""

import math
import pickle
from collections.abc import Mapping
from dataclasses import asdict, field, replace
from typing import Any, Literal

from modpush._types import Count, Fraction, Name, NonNegativeInteger, Positive, Seed, Several
from modpush._validation import checked
from modpush.agents.tqc.config import TQCConfig
from modpush.mdp.curriculum import CurriculumConfig
from modpush.recipes.config import END_TO_END, PushEnvConfig
from modpush.recipes.make_env import ENV_PARTS
from modpush.replay.config import ReplayConfig

_MAY_CHANGE = {
    "total_steps",
    "evaluate_every",
    "log_every",
    "checkpoint_every",
    "progress",
    "max_minutes",
    "collector",
    "num_collectors",
}
"""Fields that a resumed run may set differently."""


@checked
class TrainConfig:
    """A training run; the defaults are the paper's.

    All numbers of steps are environment steps, summed over the scenes. Of these numbers the paper gives
    only `total_steps`.
    """

    env: PushEnvConfig = field(default_factory=PushEnvConfig)
    """Environment in which the agent is trained."""
    tqc: TQCConfig = field(default_factory=TQCConfig)
    """Learning algorithm; its `updates_per_step` and `learning_starts` set the pace of the run."""
    replay: ReplayConfig = field(default_factory=ReplayConfig)
    """Replay buffer; its batch size must equal the learner's."""
    curriculum: CurriculumConfig = field(default_factory=CurriculumConfig)
    """Episodes that are drawn as the agent improves."""
    actor_average: Fraction = 0.0
    """Decay per update of a moving average of the actor's weights, which is evaluated and saved;
    0.999 averages over about a thousand updates. The scenes act with the newest weights. With 0
    (the paper) the newest weights are evaluated and saved, too."""
    zero_init_latent: bool = False
    """Initialise the first layer of actor and critics with zero weights for the latent and for the
    points of the entry `path_ahead`, so that what is learned in free space, where paths are
    straight, holds among obstacles until these inputs are used."""
    mirror: bool = False
    """Learn from mirror images: a random half of each batch is mirrored at the x axis of the
    agent's frame (with `env.frame="path"`, the line from the object to the sub-goal). It needs
    entries that can be mirrored; `joint_position` cannot."""
    hindsight: bool = False
    """Learn from hindsight goals as well: each episode that has ended is stored once more, with the
    object's last pose as its goal. What the agent observes is computed again for this goal, from
    recorded poses, for up to 64 episodes at once, which takes about a third of the time of acting.
    Those that wait for it at a checkpoint are dropped."""
    init_from: Name | None = None
    """Start from trained weights, and act with them from the first step. A shipped agent, given by
    its name, or an agent's file provides the weights of the actor. A run's folder or one of its
    checkpoints provides those of critics, targets and temperature as well. Entries of the
    observation that those weights do not know (`env.add`) begin with zero weights. None for random
    weights."""
    first_actions: Literal["random", "scripted"] = "random"
    """Policy of the first `tqc.learning_starts` steps, which the paper does not specify; its
    authors' code acts at random. `"scripted"` is `ScriptedPusher` with some noise, which pushes
    along the planner's sub-goals over all distances, so that the first updates see what reaching
    the goal is worth."""
    total_steps: Count = 7_000_000
    """Environment steps after which the run ends."""
    max_minutes: Positive | None = None
    """Minutes of training, over all sessions of the run, after which it ends like one that has made
    `total_steps`: with an evaluation and a checkpoint, which come on top. None for no limit."""
    rollout_length: Count = 8
    """Number of steps of each scene between two exchanges of transitions and weights."""
    async_collection: bool = True
    """Step the environment in its own process while the learner learns. Otherwise the two take
    turns in one process, with the same results."""
    collector: Literal["local", "ray"] = "local"
    """Place of the scenes: "local" on this machine (see `async_collection`), or "ray" in the
    collectors of a Ray cluster, driven by TorchRL's `Collector(backend="ray")`. A run with "local"
    gives the same numbers whenever it is repeated; with "ray" they depend on the order in which the
    collectors finish."""
    num_collectors: Count = 1
    """Number of collectors with "ray", each with `env.num_envs` scenes, one CPU and some 700 MB of
    memory."""
    greedy_envs: NonNegativeInteger = 0
    """Number of scenes that act without exploration noise; promotion in the curriculum depends on
    their successes. With 0 (the paper) all scenes act with noise and promotion depends on all of
    them. Noise frees a policy that would stand still, so that these successes overestimate the
    policy. Evaluations have no noise in either case."""
    evaluate_every: Count = 25_000
    """Environment steps between greedy evaluations on the held-out episodes."""
    evaluation_episodes: Count = 120
    """Number of held-out episodes, the same in every run, spread evenly over the scene families of the
    curriculum's last phase."""
    log_every: Count = 2_500
    """Environment steps between rows of the log."""
    checkpoint_every: Count = 50_000
    """Environment steps between checkpoints."""
    keep_checkpoints: Count = 2
    """Number of checkpoints that are kept, the newest ones."""
    save_buffer: bool = True
    """Store the replay buffer in the checkpoints. Without it a checkpoint has some megabytes and
    holds everything else that a run depends on. A resumed run then first acts for
    `tqc.learning_starts` steps, which count, with the policy that it has, and continues its updates
    with these transitions; its numbers are not those of an uninterrupted run."""
    loggers: Several[Literal["csv", "tensorboard"]] = ("csv",)
    """TorchRL loggers that are written to, beside the run's own tables."""
    progress: bool = True
    """Show a progress bar."""
    seed: Seed = 0
    """Seed of everything that is drawn at random."""

    def __post_init__(self) -> None:
        """Check that the parts fit together."""
        if not 0 <= self.greedy_envs < self.env.num_envs:
            raise ValueError(
                f"TrainConfig: greedy_envs must be in [0, {self.env.num_envs - 1}] with "
                f"{self.env.num_envs} scenes, got {self.greedy_envs}."
            )
        if self.mirror and self.env.encoder == END_TO_END:
            raise ValueError(
                "TrainConfig: mirror must be False with env.encoder='end_to_end', whose windows are not "
                "mirrored, got True."
            )
        self._check_goals()
        if self.replay.batch_size != self.tqc.batch_size:
            raise ValueError(
                "TrainConfig: replay.batch_size must be tqc.batch_size "
                f"({self.tqc.batch_size}), got {self.replay.batch_size}."
            )
        if self.tqc.learning_starts < self.sampled_from:
            raise ValueError(
                f"TrainConfig: tqc.learning_starts must be >= {self.sampled_from:g}, what one sample "
                f"draws from, got {self.tqc.learning_starts}."
            )
        if self.env.scenario.distance[1] != self.curriculum.final_distance[1]:
            raise ValueError(
                "TrainConfig: env.scenario.distance, of the held-out episodes, must go as far as "
                "curriculum.final_distance, of the last episodes of training, "
                f"{self.curriculum.final_distance}, got {self.env.scenario.distance}. Set both."
            )

    def _check_goals(self) -> None:
        tolerances, simulation = self.curriculum.yaw_tolerances, self.env.simulation
        if tolerances and (simulation.goal, simulation.yaw_tolerance) != ("pose", tolerances[-1]):
            raise ValueError(
                "TrainConfig: curriculum.yaw_tolerances must end with env.simulation.yaw_tolerance and "
                f"goal='pose', got {tolerances[-1]:.4g} rad, {simulation.yaw_tolerance:.4g} rad and "
                f"goal={simulation.goal!r}."
            )
        if not self.hindsight:
            return
        for name, value in (("arm_in_depth", False), ("dynamic_obstacles", False)):
            if getattr(simulation, name) != value:
                raise ValueError(
                    f"TrainConfig: hindsight needs env.simulation.{name}={value}, since images are drawn "
                    f"again from recorded poses, got {getattr(simulation, name)}."
                )
        if simulation.depth != "analytic" or self.collector != "local":
            raise ValueError(
                "TrainConfig: hindsight needs env.simulation.depth='analytic' and collector='local', got "
                f"{simulation.depth!r} and {self.collector!r}."
            )

    @property
    def sampled_from(self) -> float:
        """Largest number of transitions that one sample draws from."""
        if self.replay.sampler != "attentive":
            return self.tqc.batch_size
        k = self.replay.k
        queries = self.filled_replay().num_queries or 1
        share, remainder = divmod(self.tqc.batch_size, queries)  # rounded up for each query
        return remainder * math.ceil(k * (share + 1)) + (queries - remainder) * math.ceil(k * share)

    @property
    def warm_up(self) -> int:
        """Environment steps at the beginning that `ScriptedPusher` acts in."""
        scripted = self.first_actions == "scripted" and not self.init_from
        return self.tqc.learning_starts if scripted else 0

    def filled_replay(self) -> ReplayConfig:
        """The replay buffer's config with the values that follow from the rest of the run.

        One query for each scene, unless their number is given, and the learner's discount for n-step
        returns.
        """
        queries = self.replay.num_queries or self.env.num_envs
        return replace(self.replay, num_queries=queries, gamma=self.tqc.gamma)

    def differences(self, stored: "TrainConfig") -> list[str]:
        """Fields that differ from a stored run's and may not, as `"name: stored -> now"`."""
        now = self
        if self.tqc.precision == "auto":  # the stored run has found out what that means
            now = replace(self, tqc=replace(self.tqc, precision=stored.tqc.precision))
        return field_differences(stored.fixed_fields(), now.fixed_fields())

    def fixed_fields(self) -> dict[str, Any]:
        """All fields that a resumed run must have in common with what it resumes, as plain data."""
        return {name: value for name, value in asdict(self).items() if name not in _MAY_CHANGE}


def field_differences(stored: dict[str, Any], now: dict[str, Any], prefix: str = "") -> list[str]:
    """Fields that differ between two configs as plain data, as `"name: stored -> now"`."""
    found: list[str] = []
    for name in now:
        if name not in stored:
            found.append(f"{prefix}{name}: not known then -> {now[name]!r}")
            continue
        a, b = stored[name], now[name]
        if isinstance(a, dict) and isinstance(b, dict) and set(a) <= set(b):
            found += field_differences(a, b, f"{prefix}{name}.")
        elif a != b:
            found.append(f"{prefix}{name}: {a!r} -> {b!r}")
    return found


LEARNER_PARTS = ("loss", "actor", "critic")
"""Parts that `make_tqc` takes as arguments."""
REPLAY_PARTS = ("sampler", "similarity")
"""Parts that `make_replay_buffer` takes as arguments."""


def check_parts(config: TrainConfig, parts: Mapping[str, Any], *, pickled: bool = False) -> None:
    """Refuse parts of an unknown kind and, if they are to be `pickled`, those that cannot be."""
    known = (*ENV_PARTS, *LEARNER_PARTS, *REPLAY_PARTS)
    if unknown := sorted(set(parts) - set(known)):
        raise ValueError(f"parts has no {unknown}, expected some of {sorted(known)}.")
    if config.env.encoder == END_TO_END and not (config.tqc.encoder or "encoder" in parts):
        raise ValueError(
            f"env.encoder={END_TO_END!r} needs an encoder for the learner to train: "
            "tqc.encoder='modpush.encoders:ConvEncoder', 'module:name', or parts={'encoder': ...}."
        )
    if config.tqc.encoder and config.env.encoder != END_TO_END:
        raise ValueError(
            f"tqc.encoder={config.tqc.encoder!r} needs env.encoder={END_TO_END!r}, which "
            f"gives it images to encode, got {config.env.encoder!r}."
        )
    for kind, part in parts.items() if pickled else ():
        check_picklable(f"parts[{kind!r}]", part)


def check_picklable(name: str, part: Any) -> None:
    """Raise a ValueError for what a spawned process could not be given; `name` is for the message."""
    try:
        pickle.dumps(part)
    except Exception as error:
        raise ValueError(
            f"{name} must be picklable, since the environment runs in a process "
            f"of its own ({error}). Define it at the top level of a module, or use "
            "async_collection=False."
        ) from error


def learner_parts(config: TrainConfig, parts: Mapping[str, Any]) -> dict[str, Any]:
    """The arguments of `make_tqc` among the parts, with an encoder that is trained with the agent."""
    trained = {"encoder"} if config.env.encoder == END_TO_END else set()
    return {kind: part for kind, part in parts.items() if kind in {*LEARNER_PARTS} | trained}


def replay_parts(parts: Mapping[str, Any]) -> dict[str, Any]:
    """The arguments of `make_replay_buffer` among the parts."""
    return {kind: part for kind, part in parts.items() if kind in REPLAY_PARTS}
