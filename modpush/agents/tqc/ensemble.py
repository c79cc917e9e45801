"""An ensemble of equal critics as one batched matrix product per layer.

TorchRL evaluates an ensemble with `vmap` over a module whose parameters carry a leading dimension.
For a multilayer perceptron the same parameters can go straight into `baddbmm`, which spares the
tracing of `vmap` and gives the BLAS library the whole ensemble at once.
"""

from collections.abc import Callable, Sequence

import torch
from tensordict import TensorDict, TensorDictBase
from tensordict.nn import TensorDictModule
from torch import Tensor, nn
from torchrl.modules import MLP, ValueOperator

from modpush.agents.tqc.relu_mlp import ReluMLP, autocast_enabled, plain_linear, relu_mlp

__all__ = ["BatchedEnsemble", "NotBatchableError"]

# Modules without parameters or randomness that act on each element by itself, so that they take a
# leading ensemble dimension as it is.
_ELEMENTWISE = (
    nn.CELU,
    nn.ELU,
    nn.GELU,
    nn.Hardswish,
    nn.Hardtanh,
    nn.Identity,
    nn.LeakyReLU,
    nn.Mish,
    nn.ReLU,
    nn.ReLU6,
    nn.SELU,
    nn.SiLU,
    nn.Sigmoid,
    nn.Softplus,
    nn.Softsign,
    nn.Tanh,
)
_Path = tuple[str, ...]
_Layer = Callable[[Tensor, Sequence[Tensor]], Tensor]  # [N, P, in], this layer's parameters


class NotBatchableError(ValueError):
    """A critic is not a plain multilayer perceptron; the message says which part is not."""


class BatchedEnsemble:
    """Calls `N` critics at once, in place of TorchRL's `vmap` over the critic.

    Accepts a `TensorDictModule` (or `ValueOperator`) around a `torchrl.modules.MLP`, an
    `nn.Sequential` or a single `nn.Linear`, made of `Linear`, `LayerNorm` and elementwise
    activations. Several inputs are concatenated, as `MLP` does.

    Args:
        module: One critic of the ensemble. Only its structure is read, never its parameters.

    Raises:
        NotBatchableError: If the critic holds anything else, or hooks.
    """

    def __init__(self, module: TensorDictModule) -> None:
        if type(module) not in (TensorDictModule, ValueOperator):
            raise NotBatchableError(f"{type(module).__name__} is not a plain TensorDictModule")
        if len(module.out_keys) != 1:
            raise NotBatchableError(f"it writes {len(module.out_keys)} keys, not one")
        if any(part._forward_hooks or part._forward_pre_hooks for part in module.modules()):
            raise NotBatchableError("it has forward hooks")
        network = module.module
        if len(module.in_keys) > 1 and type(network) not in (MLP, ReluMLP):
            raise NotBatchableError(f"a {type(network).__name__} does not concatenate its inputs")
        self.in_keys = list(module.in_keys)
        self.out_key = module.out_keys[0]
        self.num_atoms = 0  # the output's last dimension
        self.num_inputs = 0  # the inputs' last dimensions together; 0 if no linear layer says so
        self._layers: list[tuple[_Layer, list[_Path]]] = []
        self._seen: set[nn.Parameter] = set()
        self._add(network, ("module",))
        if not self.num_atoms:
            raise NotBatchableError("it has no linear layer")
        self._is_relu_mlp = _alternates_linear_and_relu([layer for layer, _ in self._layers])

    def _add(self, part: nn.Module, path: _Path) -> None:
        parameters = [(*path, name) for name, _ in part.named_parameters(recurse=False)]
        if not self._seen.isdisjoint(part.parameters(recurse=False)):
            raise NotBatchableError("two of its layers share parameters")
        self._seen.update(part.parameters(recurse=False))
        if type(part) in (nn.Sequential, MLP, ReluMLP):
            if getattr(part, "_reshape_out", False):
                raise NotBatchableError("its MLP reshapes the output")
            for name, child in part._modules.items():  # a module may stand in several places
                if child is not None:
                    self._add(child, (*path, name))
        elif type(part) is nn.Linear:
            self._layers.append((_linear if len(parameters) == 2 else _linear_no_bias, parameters))
            self.num_inputs = part.in_features if not self._layers[:-1] else self.num_inputs
            self.num_atoms = part.out_features
        elif type(part) is nn.LayerNorm and len(part.normalized_shape) == 1:
            self._layers.append((_BatchedLayerNorm(part), parameters))
        elif type(part) in _ELEMENTWISE:
            self._layers.append((_Elementwise(part), parameters))
        else:
            raise NotBatchableError(f"it holds a {type(part).__name__}")

    def parameters(self, params: TensorDictBase) -> list[list[Tensor]]:
        """The ensemble's parameters, layer by layer, for `__call__`."""
        return [[params.get(path) for path in paths] for _, paths in self._layers]

    def atoms(self, inputs: Sequence[Tensor], parameters: Sequence[Sequence[Tensor]]) -> Tensor:
        """Evaluate all critics on the same inputs.

        Args:
            inputs: The critics' inputs in the order of `in_keys`, each `[*B, d_i]`.
            parameters: What `parameters` returned: per layer, tensors with a leading dimension
                `N`.

        Returns:
            The atoms, `[N, *B, n]`.
        """
        num_critics = next(layer[0].shape[0] for layer in parameters if layer)
        batch_size = inputs[0].shape[:-1]
        flat = [x.reshape(-1, x.shape[-1]) for x in inputs]  # [P, d_i]
        if self._is_relu_mlp:
            linear = parameters[::2]
            x = relu_mlp(flat, [weight for weight, _ in linear], [bias for _, bias in linear])
        else:
            x = flat[0] if len(flat) == 1 else torch.cat(flat, -1)
            x = x.expand(num_critics, *x.shape)  # [N, P, in]
            for (layer, _), tensors in zip(self._layers, parameters, strict=True):
                x = layer(x, tensors)
        return x.view(num_critics, *batch_size, x.shape[-1])

    def __call__(self, tensordict: TensorDictBase, params: TensorDictBase) -> TensorDict:
        """Atoms as TorchRL's `vmap` would return them: a tensordict of batch size `[N, *B]`."""
        inputs = [tensordict.get(key) for key in self.in_keys]
        atoms = self.atoms(inputs, self.parameters(params))
        batch_size = [atoms.shape[0], *tensordict.batch_size]
        return TensorDict({self.out_key: atoms}, batch_size=batch_size)


def _linear(x: Tensor, parameters: Sequence[Tensor]) -> Tensor:
    weight, bias = parameters  # [N, out, in], [N, out]
    if autocast_enabled(x):
        return plain_linear(x, weight, bias)
    return torch.baddbmm(bias.unsqueeze(1), x, weight.mT)


def _linear_no_bias(x: Tensor, parameters: Sequence[Tensor]) -> Tensor:
    return torch.bmm(x, parameters[0].mT)


class _BatchedLayerNorm:
    def __init__(self, module: nn.LayerNorm) -> None:
        self.shape = tuple(module.normalized_shape)
        self.eps = module.eps

    def __call__(self, x: Tensor, parameters: Sequence[Tensor]) -> Tensor:
        x = nn.functional.layer_norm(x, self.shape, eps=self.eps)
        for index, parameter in enumerate(parameters):  # the weight, then the bias, `[N, d]`
            x = x + parameter.unsqueeze(1) if index else x * parameter.unsqueeze(1)
        return x


class _Elementwise:
    def __init__(self, module: nn.Module) -> None:
        self.module = module

    def __call__(self, x: Tensor, parameters: Sequence[Tensor]) -> Tensor:
        return self.module(x)


def _alternates_linear_and_relu(layers: Sequence[_Layer]) -> bool:
    relu = [isinstance(layer, _Elementwise) and type(layer.module) is nn.ReLU for layer in layers]
    linear = [layer is _linear for layer in layers]
    return len(layers) % 2 == 1 and all(linear[::2]) and all(relu[1::2])
