"""TQC's networks: a tanh-squashed Gaussian actor and quantile critics."""

from collections.abc import Sequence

import torch
from tensordict.nn import NormalParamExtractor, TensorDictModule, add_custom_mapping
from tensordict.utils import NestedKey
from torch import Tensor, nn
from torchrl.data import Bounded
from torchrl.modules import ProbabilisticActor, TanhDelta, TanhNormal, ValueOperator

from modpush._types import Count, NonNegativeInteger
from modpush._validation import checked_arguments
from modpush.agents.tqc.encoder import LATENT_KEY, EncodedNetwork
from modpush.agents.tqc.ensemble import AnyFloatMLP

_LOG_SCALE_BOUNDS = (-20.0, 2.0)


def _clamped_exp(log_scale: Tensor) -> Tensor:
    return log_scale.clamp(*_LOG_SCALE_BOUNDS).exp()


# The usual parametrisation of soft actor-critics, which `NormalParamExtractor` does not know.
add_custom_mapping("modpush_clamped_exp", _clamped_exp)


@checked_arguments
def make_actor(
    observation_dim: Count,
    action_spec: Bounded,
    hidden_sizes: Sequence[Count],
    *,
    observation_key: NestedKey = "observation",
    action_key: NestedKey = "action",
    encoder: nn.Module | None = None,
    image_key: NestedKey = "window",
    deterministic: bool = False,
    device: torch.device | str | None = None,
) -> ProbabilisticActor:
    """A Gaussian policy squashed by tanh into the action's bounds.

    Args:
        observation_dim: Width of the observation.
        action_spec: Spec of one action, `[A]`, bounded.
        hidden_sizes: Widths of the hidden layers, ReLU after each.
        observation_key: Key of the observation, read, `[*B, observation_dim]`.
        action_key: Key of the action, written, `[*B, A]`.
        encoder: Encoder whose latent is read beside the observation, without gradient; see
            `encode_images`.
        image_key: Key of the encoder's images, read, `[*B, C, H, W]`.
        deterministic: Make a policy without randomness, for TD3.
        device: Device of the parameters.

    Returns:
        An actor that writes `loc`, `scale` and the action. Its log standard deviation is clamped
        to [-20, 2] before the exponential. A deterministic one writes `param`, the action before
        tanh, and the action.

    Raises:
        ValueError: If the action is not a vector of real numbers between finite limits.
    """
    _check_action_spec(action_spec)
    latent_dim = 0 if encoder is None else int(encoder.latent_dim)  # type: ignore[arg-type]
    parameters = ["param"] if deterministic else ["loc", "scale"]
    out_features = len(parameters) * action_spec.shape[-1]
    network: nn.Module = _mlp(observation_dim + latent_dim, out_features, hidden_sizes, device)
    if not deterministic:
        extractor = NormalParamExtractor(scale_mapping="modpush_clamped_exp", scale_lb=1e-6)
        network = nn.Sequential(network, extractor)
    in_keys = [observation_key]
    if encoder is not None:
        network = EncodedNetwork(encoder, network)
        in_keys.append(image_key)
    return ProbabilisticActor(
        TensorDictModule(network, in_keys=in_keys, out_keys=parameters),
        in_keys=parameters,
        out_keys=[action_key],
        spec=action_spec.to(device) if device is not None else action_spec,
        distribution_class=TanhDelta if deterministic else TanhNormal,
        distribution_kwargs=dict(zip(("low", "high"), _limits(action_spec), strict=True)),
    )


def _check_action_spec(action_spec: Bounded) -> None:
    if len(action_spec.shape) != 1:
        raise ValueError(f"action_spec must be of shape [A], got {action_spec}.")
    low, high = _limits(action_spec)
    right = action_spec.dtype.is_floating_point and bool((low < high).all())
    if not (right and low.isfinite().all() and high.isfinite().all()):
        raise ValueError(
            f"action_spec must be of real numbers with finite limits, the lower ones below the "
            f"higher ones, got {action_spec.dtype} from {low.tolist()} to {high.tolist()}."
        )


def _limits(action_spec: Bounded) -> tuple[Tensor, Tensor]:
    """The limits in the networks' dtype, which the action has then, too."""
    low, high = action_spec.space.low, action_spec.space.high
    return low.to(torch.get_default_dtype()), high.to(torch.get_default_dtype())


@checked_arguments
def make_critic(
    observation_dim: Count,
    action_dim: Count,
    num_quantiles: Count,
    hidden_sizes: Sequence[Count],
    *,
    layer_norm: bool = False,
    latent_dim: NonNegativeInteger = 0,
    observation_key: NestedKey = "observation",
    action_key: NestedKey = "action",
    device: torch.device | str | None = None,
) -> ValueOperator:
    """One critic of the ensemble: return quantiles of an observation and an action.

    Args:
        observation_dim: Width of the observation.
        action_dim: Width of the action.
        num_quantiles: Number of atoms, the output's last dimension.
        hidden_sizes: Widths of the hidden layers, ReLU after each.
        layer_norm: Normalise each hidden layer before its ReLU.
        latent_dim: Width of an image's latent, which is read under `"image_latent"`; 0 for none.
        observation_key: Key of the observation, read, `[*B, observation_dim]`.
        action_key: Key of the action, read, `[*B, action_dim]`.
        device: Device of the parameters.

    Returns:
        A critic that writes `state_action_value`, `[*B, num_quantiles]`.
    """
    in_features = observation_dim + latent_dim + action_dim
    network = _mlp(in_features, num_quantiles, hidden_sizes, device, layer_norm=layer_norm)
    latent_keys = [LATENT_KEY] if latent_dim else []
    return ValueOperator(network, in_keys=[observation_key, *latent_keys, action_key])


def _mlp(
    in_features: int,
    out_features: int,
    hidden_sizes: Sequence[int],
    device: torch.device | str | None,
    *,
    layer_norm: bool = False,
) -> AnyFloatMLP:
    return AnyFloatMLP(
        in_features=in_features,
        out_features=out_features,
        num_cells=list(hidden_sizes),
        activation_class=nn.ReLU,
        # No layer reads its own output again, so autograd does not need it from before the ReLU.
        activation_kwargs={"inplace": True},
        norm_class=nn.LayerNorm if layer_norm else None,
        norm_kwargs=[{"normalized_shape": width} for width in hidden_sizes] if layer_norm else None,
        device=device,
    )
