"""An ensemble of equal critics as one batched matrix product per layer.

TorchRL evaluates an ensemble with `vmap` over a module whose parameters carry a leading dimension.
For a multilayer perceptron the same parameters can go straight into `baddbmm`, which spares the
tracing of `vmap` and gives the BLAS library the whole ensemble at once.
"""

from collections.abc import Callable

import torch
from tensordict import TensorDict, TensorDictBase
from tensordict.nn import TensorDictModule
from torch import Tensor, nn
from torchrl.modules import MLP, ValueOperator

__all__ = ["BatchedEnsemble", "NotBatchable"]

# Modules without parameters or randomness that act on each element by itself, so that a leading
# ensemble dimension makes no difference to them.
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
_Layer = Callable[[Tensor, TensorDictBase], Tensor]  # [N, P, in], the critics' parameters


class NotBatchable(ValueError):
    """A critic is no plain multilayer perceptron; the message says which part is not."""


class BatchedEnsemble:
    """Calls `N` critics at once, in place of TorchRL's `vmap` over the critic.

    Accepts a `TensorDictModule` (or `ValueOperator`) around a `torchrl.modules.MLP`, an
    `nn.Sequential` or a single `nn.Linear`, made of `Linear`, `LayerNorm` and elementwise
    activations. Several inputs are concatenated, as `MLP` does.

    Args:
        module: One critic of the ensemble. Only its structure is read, never its parameters.

    Raises:
        NotBatchable: If the critic holds anything else, or hooks.
    """

    def __init__(self, module: TensorDictModule) -> None:
        if type(module) not in (TensorDictModule, ValueOperator):
            raise NotBatchable(f"{type(module).__name__} is not a plain TensorDictModule")
        if len(module.out_keys) != 1:
            raise NotBatchable(f"it writes {len(module.out_keys)} keys, not one")
        if any(part._forward_hooks or part._forward_pre_hooks for part in module.modules()):
            raise NotBatchable("it has forward hooks")
        network = module.module
        if len(module.in_keys) > 1 and type(network) is not MLP:
            raise NotBatchable(f"{type(network).__name__} takes its inputs apart")
        self.in_keys = list(module.in_keys)
        self.out_key = module.out_keys[0]
        self.num_atoms = -1
        self._layers: list[_Layer] = []
        self._add(network, ("module",))
        if self.num_atoms < 0:
            raise NotBatchable("it has no linear layer")

    def _add(self, part: nn.Module, path: tuple[str, ...]) -> None:
        if type(part) in (nn.Sequential, MLP):
            if getattr(part, "_reshape_out", False):
                raise NotBatchable("its MLP reshapes the output")
            for name, child in part.named_children():
                self._add(child, (*path, name))
        elif type(part) is nn.Linear:
            self._layers.append(_BatchedLinear(path, part.bias is not None))
            self.num_atoms = part.out_features
        elif type(part) is nn.LayerNorm and len(part.normalized_shape) == 1:
            self._layers.append(_BatchedLayerNorm(path, part))
        elif type(part) in _ELEMENTWISE:
            self._layers.append(_Elementwise(part))
        else:
            raise NotBatchable(f"it holds a {type(part).__name__}")

    def __call__(self, tensordict: TensorDictBase, params: TensorDictBase) -> TensorDict:
        """Evaluate all critics on the same inputs.

        Args:
            tensordict: Holds the critics' inputs, each `[*B, d_i]`.
            params: Their parameters with a leading ensemble dimension, `[N]`.

        Returns:
            The atoms, `[N, *B, n]`, under the critic's out key, batch size `[N, *B]`.
        """
        inputs = [tensordict.get(key) for key in self.in_keys]
        x = inputs[0] if len(inputs) == 1 else torch.cat(inputs, -1)
        num_critics = params.batch_size[0]
        batch_size = x.shape[:-1]
        x = x.reshape(1, -1, x.shape[-1]).expand(num_critics, -1, -1)  # [N, P, in]
        for layer in self._layers:
            x = layer(x, params)
        x = x.view(num_critics, *batch_size, x.shape[-1])
        return TensorDict({self.out_key: x}, batch_size=[num_critics, *tensordict.batch_size])


class _BatchedLinear:
    def __init__(self, path: tuple[str, ...], bias: bool) -> None:
        self.weight_key = (*path, "weight")
        self.bias_key = (*path, "bias") if bias else None

    def __call__(self, x: Tensor, params: TensorDictBase) -> Tensor:
        weight = params.get(self.weight_key)  # [N, out, in]
        if self.bias_key is None:
            return torch.bmm(x, weight.mT)
        bias = params.get(self.bias_key)  # [N, out]
        return torch.baddbmm(bias.unsqueeze(1), x, weight.mT)


class _BatchedLayerNorm:
    def __init__(self, path: tuple[str, ...], module: nn.LayerNorm) -> None:
        self.shape = tuple(module.normalized_shape)
        self.eps = module.eps
        self.weight_key = (*path, "weight") if module.weight is not None else None
        self.bias_key = (*path, "bias") if module.bias is not None else None

    def __call__(self, x: Tensor, params: TensorDictBase) -> Tensor:
        x = nn.functional.layer_norm(x, self.shape, eps=self.eps)
        if self.weight_key is not None:
            x = x * params.get(self.weight_key).unsqueeze(1)
        if self.bias_key is not None:
            x = x + params.get(self.bias_key).unsqueeze(1)
        return x


class _Elementwise:
    def __init__(self, module: nn.Module) -> None:
        self.module = module

    def __call__(self, x: Tensor, params: TensorDictBase) -> Tensor:
        return self.module(x)
