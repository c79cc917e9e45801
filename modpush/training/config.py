"""Everything that defines a training run, and its presets."""

from dataclasses import asdict, dataclass, field, replace
from typing import Any, Literal

from modpush.agents.tqc.config import TQCConfig
from modpush.mdp.curriculum import CurriculumConfig, Phase
from modpush.recipes.paper import PushEnvConfig
from modpush.replay import ReplayConfig

__all__ = ["TRAIN_PRESETS", "TrainConfig"]

_MAY_CHANGE = {"total_steps", "evaluate_every", "log_every", "checkpoint_every", "progress"}
"""Fields that a resumed run may set differently."""


@dataclass(frozen=True, kw_only=True)
class TrainConfig:
    """A training run. Steps are environment steps, summed over the scenes."""

    env: PushEnvConfig = field(default_factory=PushEnvConfig)
    """What is learned in."""
    tqc: TQCConfig = field(default_factory=TQCConfig)
    """The learner; its `updates_per_step` and `learning_starts` pace the run."""
    replay: ReplayConfig = field(default_factory=ReplayConfig)
    """What is learned from; its batch size is the learner's."""
    curriculum: CurriculumConfig = field(default_factory=CurriculumConfig)
    """Which episodes are drawn."""
    blind_start: bool = False
    """Begin with weights of zero for the latent, in actor and critics: what is learned in free space
    then holds among obstacles, until the latent has something to say."""
    total_steps: int = 7_000_000
    """When to stop."""
    chunk: int = 8
    """Steps of each scene between two exchanges of data and weights."""
    side_by_side: bool = True
    """Environment and learner in a process each, or taking turns in one."""
    greedy_scenes: int = 4
    """Number of scenes that act without noise; only their episodes count for the curriculum."""
    evaluate_every: int = 25_000
    """Steps between greedy evaluations on the held-out episodes."""
    evaluation_episodes: int = 120
    """Held-out episodes, the same in every run; spread evenly over the curriculum's last families."""
    log_every: int = 2_500
    """Steps between lines of the log."""
    checkpoint_every: int = 50_000
    """Steps between checkpoints."""
    keep_checkpoints: int = 2
    """Newest checkpoints kept."""
    save_buffer: bool = True
    """Keep the replay buffer in the checkpoints; without it, a resumed run fills a new one first."""
    loggers: tuple[Literal["csv", "tensorboard"], ...] = ("csv", "tensorboard")
    """TorchRL's loggers that are written to."""
    progress: bool = True
    """Show a progress bar."""
    seed: int = 0
    """Of everything that is drawn."""

    def __post_init__(self) -> None:
        """Check ranges, and that the parts fit together."""
        for name in (
            *("total_steps", "chunk", "evaluate_every", "evaluation_episodes", "log_every"),
            *("checkpoint_every", "keep_checkpoints"),
        ):
            if getattr(self, name) < 1:
                raise ValueError(f"TrainConfig: {name} must be >= 1, got {getattr(self, name)}.")
        if not 0 <= self.greedy_scenes < self.env.num_envs:
            raise ValueError(
                f"TrainConfig: greedy_scenes must be in [0, {self.env.num_envs - 1}] with "
                f"{self.env.num_envs} scenes, got {self.greedy_scenes}."
            )
        if self.replay.batch_size != self.tqc.batch_size:
            raise ValueError(
                "TrainConfig: replay.batch_size must be tqc.batch_size "
                f"({self.tqc.batch_size}), got {self.replay.batch_size}."
            )
        if self.replay.n_steps != 1:
            raise ValueError(
                "TrainConfig: replay.n_steps must be 1 (the run stores single transitions), got "
                f"{self.replay.n_steps}."
            )
        needed = self.tqc.batch_size * (self.replay.k if self.replay.sampler == "attentive" else 1)
        if self.tqc.learning_starts < needed:
            raise ValueError(
                f"TrainConfig: tqc.learning_starts must be >= {needed:g}, what one sample draws "
                f"from, got {self.tqc.learning_starts}."
            )

    def differences(self, stored: "TrainConfig") -> list[str]:
        """Fields that differ from a stored run's and may not, as `"name: stored -> now"`."""
        return _differences(asdict(stored), asdict(self), "")


def _differences(stored: dict[str, Any], now: dict[str, Any], prefix: str) -> list[str]:
    found: list[str] = []
    for name in now:
        if prefix == "" and name in _MAY_CHANGE:
            continue
        a, b = stored[name], now[name]
        if isinstance(a, dict) and isinstance(b, dict) and set(a) == set(b):
            found += _differences(a, b, f"{prefix}{name}.")
        elif a != b:
            found.append(f"{prefix}{name}: {a!r} -> {b!r}")
    return found


def _cpu() -> TrainConfig:
    return TrainConfig(
        env=PushEnvConfig.preset("cpu"),
        tqc=TQCConfig.preset("cpu", updates_per_step=1 / 12),
        replay=ReplayConfig(batch_size=256, storage="compact"),
        blind_start=True,
        total_steps=800_000,
        evaluate_every=50_000,
    )


def _smoke() -> TrainConfig:
    cpu = _cpu()
    return replace(
        cpu,
        env=replace(
            cpu.env,
            num_envs=2,
            max_episode_steps=20,
            encoder="rays",
            scene=("free", "posts"),
        ),
        tqc=replace(cpu.tqc, hidden_sizes=(16,), batch_size=16, learning_starts=64),
        replay=ReplayConfig(batch_size=16, capacity=10_000, storage="compact"),
        curriculum=CurriculumConfig(
            phases=(Phase(scenes=("free",)), Phase(first_stage=10)),
            window=4,
        ),
        total_steps=480,
        greedy_scenes=1,
        evaluate_every=240,
        evaluation_episodes=4,
        log_every=48,
        checkpoint_every=160,
        side_by_side=False,
        progress=False,
    )


TRAIN_PRESETS: dict[str, tuple[str, TrainConfig]] = {
    "cpu": ("What learned best on two cores, in some twenty minutes.", _cpu()),
    "paper": (
        "The paper's numbers: 7e6 steps, an update each; days on a CPU.",
        TrainConfig(env=PushEnvConfig.preset("paper"), tqc=TQCConfig.preset("paper")),
    ),
    "gpu": (
        "The paper's networks in CUDA graphs beside the environment on the CPU.",
        TrainConfig(
            env=PushEnvConfig.preset("cpu"),
            tqc=TQCConfig.preset("gpu"),
            replay=ReplayConfig(device="cuda"),
            blind_start=True,
            total_steps=2_000_000,
        ),
    ),
    "smoke": ("Does everything once in some seconds, and learns nothing.", _smoke()),
}
"""By name: what it is for, and the config."""
