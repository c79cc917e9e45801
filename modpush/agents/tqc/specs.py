"""`LearnerSpecs`: what an agent's networks and loss are built for."""

from dataclasses import dataclass

from tensordict.utils import NestedKey
from torch import nn
from torchrl.data import Bounded, Composite

__all__ = ["LearnerSpecs"]


@dataclass(frozen=True, kw_only=True)
class LearnerSpecs:
    """Specs and keys that the networks and the loss read and write; an argument of their factories."""

    observation: Composite
    """Specs of everything that the environment observes, without batch dimensions."""
    action: Bounded
    """Spec of one action, `[A]`."""
    observation_key: NestedKey = "observation"
    """Key of the flat observation, `[*B, D]`."""
    action_key: NestedKey = "action"
    """Key of the action, `[*B, A]`."""
    encoder: nn.Module | None = None
    """Image encoder to be trained with the critics, or None; it has an int `latent_dim`."""
    image_key: NestedKey = "window"
    """Key of the images that the encoder reads, `[*B, C, H, W]`."""

    @property
    def observation_dim(self) -> int:
        """Width of the flat observation.

        Raises:
            ValueError: If there is no such observation, or it is not flat.
        """
        spec = self.observation.get(self.observation_key, None)
        if spec is None:
            keys = list(self.observation.keys(True, True))
            raise ValueError(
                f"make_tqc: observation_key {self.observation_key!r} not found, the env has {keys}."
            )
        if len(spec.shape) != 1:
            raise ValueError(
                f"make_tqc: {self.observation_key!r} must be a flat observation [D], got shape "
                f"{tuple(spec.shape)}; flatten it with torchrl's FlattenObservation or CatTensors."
            )
        return spec.shape[0]

    @property
    def latent_dim(self) -> int:
        """Width of the encoder's latent, 0 without an encoder."""
        return 0 if self.encoder is None else int(self.encoder.latent_dim)  # type: ignore[arg-type]
