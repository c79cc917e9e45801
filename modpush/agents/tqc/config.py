"""`TQCConfig`: everything that defines a TQC agent."""

import math
from dataclasses import replace
from typing import Any, Literal

from modpush._precision import Precision
from modpush._types import (
    AtLeastOne,
    Count,
    Device,
    Finite,
    Fraction,
    Name,
    NonNegative,
    NonNegativeInteger,
    PartName,
    Positive,
    PositiveFraction,
)
from modpush._validation import checked
from modpush.agents.tqc.update import Execution

Preset = Literal["paper", "cpu"]


@checked
class TQCConfig:
    """Everything that defines a TQC agent; the defaults are the paper's (Sec. IV-B, V).

    The paper gives the sizes of the networks, the batch size and the exploration noise. The rest is as
    in its authors' code and in sb3-contrib, which that code uses.
    """

    loss: Name = "tqc"
    """Loss: "tqc", TorchRL's "sac" or "td3", or "module:name" of a loss factory. Fields that do not
    apply to the loss have no effect: quantiles with "sac" and "td3", the temperature with "td3"."""
    actor: Name = "mlp"
    """Network of the actor: "mlp" (for the loss "td3" that is "deterministic_mlp"),
    "deterministic_mlp", or "module:name" of an actor factory."""
    critic: Name = "mlp"
    """Network of each critic: "mlp", or "module:name" of a critic factory."""
    encoder: PartName | None = None
    """Image encoder that the critics' loss trains: "module:name" of a class or of a function that
    makes one, such as "modpush.encoders:ConvEncoder". None trains no encoder."""
    image_key: Name = "window"
    """Key of the images that this encoder reads, as bytes or as floats in [0, 1]."""
    hidden_sizes: AtLeastOne[Count] = (512, 256, 128)
    """Widths of the hidden layers of the actor and of each critic."""
    num_critics: Count = 2
    """Number of critics in the ensemble."""
    num_quantiles: Count = 25
    """Number of return quantiles (atoms) that each critic predicts."""
    top_quantiles_to_drop_per_net: NonNegativeInteger = 2
    """Number of highest atoms, per critic, that are dropped from the pooled target."""
    layer_norm: bool = False
    """Normalise the hidden layers of the critics."""
    gamma: Fraction = 0.98
    """Discount factor per step."""
    tau: PositiveFraction = 0.005
    """Fraction by which the target critics move towards the critics in each update."""
    actor_lr: Positive = 1e-4
    """Learning rate of the actor (Adam)."""
    critic_lr: Positive = 1e-4
    """Learning rate of the critics (Adam)."""
    alpha_lr: Positive = 1e-4
    """Learning rate of the logarithm of the entropy temperature (Adam)."""
    alpha_init: Positive = 1.0
    """Entropy temperature at the start of training."""
    min_alpha: NonNegative | None = None
    """Lower bound of the entropy temperature; None for no bound."""
    max_alpha: Positive | None = None
    """Upper bound of the entropy temperature; None for no bound."""
    fixed_alpha: bool = False
    """Keep the entropy temperature at its initial value."""
    target_entropy: Finite | Literal["auto"] = "auto"
    """Entropy of the policy that the temperature aims at [nat]; "auto" is minus the number of
    action components."""
    skip_done_states: bool = False
    """Do not evaluate the next states of terminal transitions (they may be NaN)."""
    exploration_sigma: NonNegative = 0.4
    """Standard deviation of the exploration noise, in units of half the action's range."""
    batch_size: Count = 512
    """Number of transitions in each update."""
    learning_starts: NonNegativeInteger = 10_000
    """Number of environment steps before the first update."""
    updates_per_step: Positive = 1.0
    """Number of updates per environment step."""
    device: Device = "cpu"
    """Torch device of the networks and updates; only "cpu" has been tried."""
    execution: Execution = "eager"
    """Execution of an update: operation by operation ("eager"), compiled ("compile"), or compiled and
    recorded on a CUDA device ("cudagraph"); see `TQCUpdate`."""

    precision: Precision | Literal["auto"] = "float32"
    """Precision of the networks on the CPU, in updates and in the scenes that act in a run: "float32";
    "bfloat16", for their layers alone, with sums in float32; or "auto", the one that is faster on this
    processor."""

    def __post_init__(self) -> None:
        """Check what depends on several fields."""
        if self.top_quantiles_to_drop_per_net >= self.num_quantiles:
            raise ValueError(
                "TQCConfig: top_quantiles_to_drop_per_net must be < num_quantiles "
                f"({self.num_quantiles}), got {self.top_quantiles_to_drop_per_net}."
            )
        low = 0.0 if self.min_alpha is None else self.min_alpha
        high = math.inf if self.max_alpha is None else self.max_alpha
        if not low <= self.alpha_init <= high:
            raise ValueError(
                "TQCConfig: alpha_init must lie between min_alpha and max_alpha, got "
                f"{self.min_alpha} <= {self.alpha_init} <= {self.max_alpha}."
            )

    @property
    def actor_network(self) -> str:
        """Name of the actor's network, with the loss taken into account."""
        return "deterministic_mlp" if (self.actor, self.loss) == ("mlp", "td3") else self.actor

    @classmethod
    def preset(cls, name: Preset, **overrides: Any) -> "TQCConfig":
        """A named set of values, with single fields overridden.

        Args:
            name: `"paper"` is the paper's setting. `"cpu"` is what learned best in minutes on two
                cores: small networks, few updates per step, a temperature that fits rewards of
                order 1.
            **overrides: Fields to set differently.

        Raises:
            ValueError: If there is no such preset.
        """
        if name not in _PRESETS:
            raise ValueError(f"TQCConfig: preset must be one of {sorted(_PRESETS)}, got {name!r}.")
        return replace(cls(**_PRESETS[name]), **overrides)


_PRESETS: dict[str, dict[str, Any]] = {
    "paper": {},
    "cpu": {
        "actor_lr": 3e-4,
        "critic_lr": 3e-4,
        "alpha_lr": 3e-4,
        "hidden_sizes": (256, 256),
        "batch_size": 256,
        "alpha_init": 0.02,
        "learning_starts": 3000,
        "updates_per_step": 0.125,
        "precision": "auto",
    },
}
