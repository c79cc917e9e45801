"""A stack of linear layers with ReLU between them, as one differentiable operation.

Layer by layer, autograd allocates each activation twice, copies every weight gradient to undo a
transpose, and walks a graph of small nodes. The whole stack at once needs none of that: ReLU acts
in place, forwards and backwards, and weight gradients come out in the weights' own layout. On CPU
this is a quarter of a TQC update.
"""

from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor, nn
from torchrl.modules import MLP

__all__ = ["ReluMLP", "relu_mlp"]


class ReluMLP(MLP):
    """TorchRL's `MLP` with ReLU, `N = 1` of `relu_mlp`: same parameters, same outputs, faster.

    Args:
        in_features: Width of the (concatenated) input.
        out_features: Width of the output.
        num_cells: Widths of the hidden layers.
        device: Where the parameters live.
    """

    def __init__(
        self,
        in_features: int,
        out_features: int,
        num_cells: Sequence[int],
        device: torch.device | str | None = None,
    ) -> None:
        super().__init__(
            in_features=in_features,
            out_features=out_features,
            num_cells=list(num_cells),
            activation_class=nn.ReLU,
            device=device,
        )

    def forward(self, *inputs: Tensor) -> Tensor:
        """`[*B, d_i]` each, to `[*B, out_features]`."""
        if torch._C._are_functorch_transforms_active():
            return super().forward(*inputs)  # `vmap` sees through layers, not through ours
        x = inputs[0] if len(inputs) == 1 else torch.cat(inputs, -1)
        linear = [layer for layer in self if isinstance(layer, nn.Linear)]
        output = relu_mlp(
            x.reshape(1, -1, x.shape[-1]),
            [layer.weight.unsqueeze(0) for layer in linear],
            [layer.bias.unsqueeze(0) for layer in linear],
        )
        return output.view(*x.shape[:-1], output.shape[-1])


def relu_mlp(x: Tensor, weights: Sequence[Tensor], biases: Sequence[Tensor]) -> Tensor:
    """Evaluate `N` equal multilayer perceptrons, ReLU after each layer but the last.

    Differentiable once, with respect to all arguments.

    Args:
        x: Inputs, `[N, P, in]` (expanded along `N` where the networks share them).
        weights: One `[N, out_l, in_l]` a layer.
        biases: One `[N, out_l]` a layer.

    Returns:
        Outputs, `[N, P, out]`.
    """
    parameters = [tensor for layer in zip(weights, biases, strict=True) for tensor in layer]
    if torch.is_grad_enabled():
        return _ReluMLP.apply(x, *parameters)
    for activation in _activations(x, parameters):
        x = activation  # earlier layers may be freed at once
    return x


def _activations(x: Tensor, parameters: Sequence[Tensor]) -> Any:
    for index in range(0, len(parameters), 2):
        weight, bias = parameters[index], parameters[index + 1]
        x = torch.baddbmm(bias.unsqueeze(1), x, weight.mT)
        if index + 2 < len(parameters):
            x = x.relu_()
        yield x


class _ReluMLP(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, x: Tensor, *parameters: Tensor) -> Tensor:
        *hidden, output = _activations(x, parameters)
        ctx.save_for_backward(x, *hidden, *parameters[::2])
        return output

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx: Any, grad: Tensor) -> tuple[Tensor | None, ...]:
        num_layers = len(ctx.saved_tensors) // 2
        inputs, weights = ctx.saved_tensors[:num_layers], ctx.saved_tensors[num_layers:]
        grads: list[Tensor | None] = [None] * (1 + 2 * num_layers)
        for layer in reversed(range(num_layers)):
            if ctx.needs_input_grad[1 + 2 * layer]:
                grads[1 + 2 * layer] = torch.bmm(grad.mT, inputs[layer])
            if ctx.needs_input_grad[2 + 2 * layer]:
                grads[2 + 2 * layer] = grad.sum(1)
            if layer:
                grad = torch.bmm(grad, weights[layer])
                # This function made `grad`, so it may overwrite it.
                torch.ops.aten.threshold_backward.grad_input(
                    grad, inputs[layer], 0, grad_input=grad
                )
            elif ctx.needs_input_grad[0]:
                grads[0] = torch.bmm(grad, weights[0])
        return tuple(grads)
