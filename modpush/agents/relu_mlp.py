"""A stack of linear layers with ReLU between them, as one differentiable operation.

Layer by layer, autograd allocates each activation twice, copies every weight gradient to undo a
transpose, and walks a graph of small nodes. The whole stack at once needs none of that: ReLU acts
in place, forwards and backwards, and weight gradients come out in the weights' own layout. On CPU
this is a quarter of a TQC update.
"""

from collections.abc import Iterator, Sequence
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
        linear = [layer for layer in self if isinstance(layer, nn.Linear)]
        output = relu_mlp(
            [x.reshape(-1, x.shape[-1]) for x in inputs],
            [layer.weight.unsqueeze(0) for layer in linear],
            [layer.bias.unsqueeze(0) for layer in linear],
        )
        return output.view(*inputs[0].shape[:-1], output.shape[-1])


def relu_mlp(
    inputs: Sequence[Tensor], weights: Sequence[Tensor], biases: Sequence[Tensor]
) -> Tensor:
    """Evaluate `N` equal multilayer perceptrons, ReLU after each layer but the last.

    Differentiable once, with respect to all arguments.

    Args:
        inputs: What the first layer sees side by side, the same for all networks, `[P, d_i]`.
        weights: One `[N, out_l, in_l]` a layer.
        biases: One `[N, out_l]` a layer.

    Returns:
        Outputs, `[N, P, out]`.
    """
    parameters = [tensor for layer in zip(weights, biases, strict=True) for tensor in layer]
    if torch.is_grad_enabled():
        return _ReluMLP.apply(len(inputs), *inputs, *parameters)
    for activation in _activations(inputs, parameters):
        x = activation  # earlier layers may be freed at once
    return x


def _activations(inputs: Sequence[Tensor], parameters: Sequence[Tensor]) -> Iterator[Tensor]:
    """The first layer's input, `[N, P, in]`, and then each layer's output."""
    x = inputs[0] if len(inputs) == 1 else torch.cat(list(inputs), -1)
    x = x.expand(parameters[0].shape[0], *x.shape)
    yield x
    for index in range(0, len(parameters), 2):
        weight, bias = parameters[index], parameters[index + 1]
        x = torch.baddbmm(bias.unsqueeze(1), x, weight.mT)
        if index + 2 < len(parameters):
            x = x.relu_()
        yield x


class _ReluMLP(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, num_inputs: int, *tensors: Tensor) -> Tensor:
        inputs, parameters = tensors[:num_inputs], tensors[num_inputs:]
        *hidden, output = _activations(inputs, parameters)
        ctx.save_for_backward(*hidden, *parameters[::2])
        ctx.widths = [x.shape[-1] for x in inputs]
        return output

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx: Any, grad: Tensor) -> tuple[Tensor | None, ...]:
        num_layers = len(ctx.saved_tensors) // 2
        inputs, weights = ctx.saved_tensors[:num_layers], ctx.saved_tensors[num_layers:]
        first = 1 + len(ctx.widths)  # of the parameters among the arguments
        grads: list[Tensor | None] = [None] * (first + 2 * num_layers)
        for layer in reversed(range(num_layers)):
            weight, bias = first + 2 * layer, first + 2 * layer + 1
            if ctx.needs_input_grad[weight]:
                grads[weight] = torch.bmm(grad.mT, inputs[layer])
            if ctx.needs_input_grad[bias]:
                grads[bias] = grad.sum(1)
            if layer:
                grad = torch.bmm(grad, weights[layer])
                # This function made `grad`, so it may overwrite it.
                torch.ops.aten.threshold_backward.grad_input(
                    grad, inputs[layer], 0, grad_input=grad
                )
        # An actor's step needs the action's gradient only, not the observation's.
        for index, columns in enumerate(weights[0].split(ctx.widths, dim=-1)):
            if ctx.needs_input_grad[1 + index]:
                grads[1 + index] = torch.bmm(grad, columns).sum(0)
        return tuple(grads)
