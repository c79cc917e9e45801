"""An ensemble of equal critics as one batched matrix product per layer, without `vmap`."""

from collections.abc import Iterator, Sequence

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModule
from torch import Tensor, nn
from torchrl.modules import MLP, ValueOperator

from modpush._precision import autocast

_ELEMENTWISE = (
    nn.CELU,
    nn.ELU,
    nn.GELU,
    nn.Hardswish,
    nn.Identity,
    nn.LeakyReLU,
    nn.Mish,
    nn.ReLU,
    nn.SELU,
    nn.SiLU,
    nn.Sigmoid,
    nn.Softplus,
    nn.Tanh,
)
_Path = tuple[str, ...]


class AnyFloatMLP(MLP):
    """TorchRL's `MLP`, whose inputs may have another floating dtype than its parameters."""

    def forward(self, *inputs: Tensor) -> Tensor:
        """`[*B, d_i]` each, to `[*B, out_features]`; a ValueError if they have more or fewer values."""
        if (width := sum(x.shape[-1] for x in inputs)) != self[0].in_features:
            raise ValueError(
                f"AnyFloatMLP: expected {self[0].in_features} input values, got {width}. An agent "
                "needs the observation of its own environment, Agent.make_env."
            )
        weight = self[0].weight
        with autocast(weight.device):
            return super().forward(*(x.to(weight.dtype) for x in inputs)).to(weight.dtype)


class NotBatchableError(ValueError):
    """A critic is not a plain multilayer perceptron; the message says which part is not."""


class BatchedEnsemble:
    """Calls `N` critics at once, in place of TorchRL's `vmap` over the critic.

    Accepts a `TensorDictModule` (or `ValueOperator`) around a `torchrl.modules.MLP`, an `nn.Sequential`
    or a single `nn.Linear`, made of `Linear`, `LayerNorm` and elementwise activations, else raises a
    NotBatchableError. Several inputs are concatenated, as `MLP` does. Only the critic's structure is
    read.
    """

    def __init__(self, critic: TensorDictModule) -> None:
        if type(critic) not in (TensorDictModule, ValueOperator) or len(critic.out_keys) != 1:
            raise NotBatchableError(f"it is not a TensorDictModule with one output: {critic}")
        if any(part._forward_hooks or part._forward_pre_hooks for part in critic.modules()):
            raise NotBatchableError("it has forward hooks")
        network = critic.module
        if len(critic.in_keys) > 1 and not isinstance(network, MLP):
            raise NotBatchableError(f"a {type(network).__name__} does not concatenate its inputs")
        self.in_keys = list(critic.in_keys)
        self._layers = list(_layers(network, ("module",)))
        linear = [layer for layer, _ in self._layers if type(layer) is nn.Linear]
        if not linear:
            raise NotBatchableError("it has no linear layer")
        parameters = [tensor for layer, _ in self._layers for tensor in layer.parameters()]
        if len(set(parameters)) < len(parameters):
            raise NotBatchableError("two of its layers share parameters")
        self.num_inputs = linear[0].in_features
        """The inputs' last dimensions together."""
        self.num_atoms = linear[-1].out_features
        """The output's last dimension."""

    def __call__(self, inputs: Sequence[Tensor], params: TensorDictBase) -> Tensor:
        """Atoms `[N, *B, n]` of all critics on the same inputs, `[*B, d_i]` each, in `in_keys`' order.

        Each parameter has a leading dimension `N`.
        """
        tensors = [[params.get(path) for path in paths] for _, paths in self._layers]
        weight = next(layer[0] for layer in tensors if layer)
        flat = torch.cat([x.reshape(-1, x.shape[-1]) for x in inputs], -1).to(weight.dtype)
        x = flat.expand(len(weight), *flat.shape)
        with autocast(weight.device):
            for (layer, _), parameters in zip(self._layers, tensors, strict=True):
                x = _apply(layer, x, *parameters)
        return x.to(weight.dtype).reshape(len(weight), *inputs[0].shape[:-1], self.num_atoms)


def _layers(part: nn.Module, path: _Path) -> Iterator[tuple[nn.Module, list[_Path]]]:
    """Each layer with the paths of its parameters: the weight, then the bias."""
    if type(part) in (nn.Sequential, MLP, AnyFloatMLP) and not getattr(part, "_reshape_out", False):
        for name, child in part._modules.items():  # a module may stand in several places
            assert child is not None
            yield from _layers(child, (*path, name))
        return
    over_features = type(part) is nn.LayerNorm and len(part.normalized_shape) == 1
    if not over_features and type(part) not in (nn.Linear, *_ELEMENTWISE):
        raise NotBatchableError(f"it holds a {type(part).__name__}")
    yield part, [(*path, name) for name, _ in part.named_parameters()]


def _apply(
    layer: nn.Module, x: Tensor, weight: Tensor | None = None, bias: Tensor | None = None
) -> Tensor:
    """One layer of all critics, `[N, P, d]` to `[N, P, e]`."""
    if isinstance(layer, nn.LayerNorm):
        x = nn.functional.layer_norm(x, layer.normalized_shape, eps=layer.eps)
        if weight is None:
            return x
        weight = weight.to(x.dtype).unsqueeze(1)
        return (
            x * weight if bias is None else torch.addcmul(bias.to(x.dtype).unsqueeze(1), x, weight)
        )
    if weight is None:
        return layer(x)
    if bias is None:
        return torch.bmm(x, weight.mT)
    return torch.baddbmm(bias.unsqueeze(1), x, weight.mT)
