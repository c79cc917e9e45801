"""`TQCConfig`: everything that defines a TQC agent."""

import math
from dataclasses import dataclass, fields, replace
from typing import Any, Literal

from modpush.agents.tqc.update import Execution

__all__ = ["TQCConfig"]

Preset = Literal["paper", "cpu", "gpu"]


@dataclass(frozen=True, kw_only=True)
class TQCConfig:
    """Everything that defines a TQC agent; the defaults are the paper's."""

    loss: str = "tqc"
    """Loss: "tqc", or "module:name" of a loss factory."""
    actor: str = "mlp"
    """Network of the actor: "mlp", or "module:name" of an actor factory."""
    critic: str = "mlp"
    """Network of each critic: "mlp", or "module:name" of a critic factory."""
    encoder: str | None = None
    """Image encoder that the critics' loss trains: "module:name" of a class or function that makes
    one, such as "modpush.encoders:ConvEncoder". None trains no encoder."""
    image_key: str = "window"
    """Key of the images that this encoder reads, as bytes or as floats in [0, 1]."""
    hidden_sizes: tuple[int, ...] = (512, 256, 128)
    """Widths of the hidden layers of the actor and of each critic."""
    num_critics: int = 2
    """Number of critics in the ensemble."""
    num_quantiles: int = 25
    """Number of return quantiles (atoms) that each critic predicts."""
    top_quantiles_to_drop_per_net: int = 2
    """Number of highest atoms, per critic, that are dropped from the pooled target."""
    layer_norm: bool = False
    """Normalise the hidden layers of the critics."""
    gamma: float = 0.98
    """Discount factor per step."""
    tau: float = 0.005
    """Fraction by which the target critics move towards the critics in each update."""
    actor_lr: float = 1e-4
    """Learning rate of the actor (Adam)."""
    critic_lr: float = 1e-4
    """Learning rate of the critics (Adam)."""
    alpha_lr: float = 1e-4
    """Learning rate of the logarithm of the entropy temperature (Adam)."""
    alpha_init: float = 1.0
    """Entropy temperature at the start of training."""
    min_alpha: float | None = None
    """Lower bound of the entropy temperature; None for no bound."""
    max_alpha: float | None = None
    """Upper bound of the entropy temperature; None for no bound."""
    fixed_alpha: bool = False
    """Keep the entropy temperature at its initial value."""
    target_entropy: float | Literal["auto"] = "auto"
    """Entropy of the policy that the temperature aims at [nat]; "auto" is minus the number of
    action components."""
    skip_done_states: bool = False
    """Do not evaluate the next states of terminal transitions (they may be NaN)."""
    exploration_sigma: float = 0.4
    """Standard deviation of the exploration noise, in units of half the action's range."""
    batch_size: int = 512
    """Number of transitions in each update."""
    learning_starts: int = 10_000
    """Number of environment steps with random actions before the first update."""
    updates_per_step: float = 1.0
    """Number of updates per environment step."""
    device: str = "cpu"
    """Torch device of the networks and updates."""
    execution: Execution = "eager"
    """How an update runs: operation by operation ("eager"), compiled, or as one CUDA graph."""

    def __post_init__(self) -> None:
        """Check the ranges."""
        self._check_finite()
        for name in (
            "num_critics",
            "num_quantiles",
            "batch_size",
            "tau",
            "actor_lr",
            "critic_lr",
            "alpha_lr",
            "alpha_init",
            "updates_per_step",
        ):
            if not getattr(self, name) > 0:
                raise ValueError(f"TQCConfig: {name} must be > 0, got {getattr(self, name)}.")
        for name in ("exploration_sigma", "learning_starts", "top_quantiles_to_drop_per_net"):
            if not getattr(self, name) >= 0:
                raise ValueError(f"TQCConfig: {name} must be >= 0, got {getattr(self, name)}.")
        if not self.hidden_sizes or min(self.hidden_sizes) < 1:
            raise ValueError(
                f"TQCConfig: hidden_sizes must hold widths >= 1, got {self.hidden_sizes}."
            )
        if not 0 <= self.gamma <= 1:
            raise ValueError(f"TQCConfig: gamma must be in [0, 1], got {self.gamma}.")
        if self.tau > 1:
            raise ValueError(f"TQCConfig: tau must be in (0, 1], got {self.tau}.")
        if self.top_quantiles_to_drop_per_net >= self.num_quantiles:
            raise ValueError(
                "TQCConfig: top_quantiles_to_drop_per_net must be < num_quantiles "
                f"({self.num_quantiles}), got {self.top_quantiles_to_drop_per_net}."
            )
        self._check_alpha()

    def _check_finite(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            if isinstance(value, float) and not math.isfinite(value):
                raise ValueError(f"TQCConfig: {field.name} must be finite, got {value}.")
        if isinstance(self.target_entropy, str) and self.target_entropy != "auto":
            raise ValueError(
                f"TQCConfig: target_entropy must be a number or 'auto', got {self.target_entropy!r}."
            )

    def _check_alpha(self) -> None:
        if self.max_alpha is not None and not self.max_alpha > 0:
            raise ValueError(
                f"TQCConfig: max_alpha must be > 0, or None for no bound, got {self.max_alpha}."
            )
        low = 0.0 if self.min_alpha is None else self.min_alpha
        high = math.inf if self.max_alpha is None else self.max_alpha
        if not 0 <= low <= self.alpha_init <= high:
            raise ValueError(
                "TQCConfig: alpha_init must lie between min_alpha and max_alpha, got "
                f"{self.min_alpha} <= {self.alpha_init} <= {self.max_alpha}."
            )

    @classmethod
    def preset(cls, name: Preset, **overrides: Any) -> "TQCConfig":
        """A named set of values, with single fields overridden.

        Args:
            name: `"paper"` is the paper's setting. `"cpu"` is what learned best in minutes on two
                cores: small networks, few updates per step, a temperature that fits rewards of
                order 1. `"gpu"` is the paper's networks with that temperature in CUDA graphs.
            **overrides: Fields to set differently.

        Raises:
            ValueError: If there is no such preset.
        """
        if name not in _PRESETS:
            raise ValueError(f"TQCConfig: preset must be one of {sorted(_PRESETS)}, got {name!r}.")
        return replace(cls(**_PRESETS[name]), **overrides)


_LEARNING_RATE = {"actor_lr": 3e-4, "critic_lr": 3e-4, "alpha_lr": 3e-4}
_PRESETS: dict[str, dict[str, Any]] = {
    "paper": {},
    "cpu": {
        **_LEARNING_RATE,
        "hidden_sizes": (256, 256),
        "batch_size": 256,
        "alpha_init": 0.02,
        "learning_starts": 3000,
        "updates_per_step": 0.125,
    },
    "gpu": {
        **_LEARNING_RATE,
        "alpha_init": 0.02,
        "updates_per_step": 0.125,
        "device": "cuda",
        "execution": "cudagraph",
    },
}
