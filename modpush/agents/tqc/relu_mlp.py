"""A stack of linear layers with ReLU between them, as one differentiable operation.

Layer by layer, autograd allocates each activation twice, copies every weight gradient to undo a
transpose, and walks a graph of small nodes. The whole stack at once needs none of that: ReLU acts
in place, forwards and backwards, and weight gradients come out in the weights' own layout.

On processors with AVX-512 the products are oneDNN's, which torch brings along but uses for single
precision in convolutions only. MKL, which torch takes for matrices, does not use AVX-512 on AMD's
processors and takes twice as long there. Elsewhere they are torch's own.
"""

from collections.abc import Sequence
from functools import cache
from typing import Any

import torch
from torch import Tensor, nn
from torchrl.modules import MLP

__all__ = ["ReluMLP", "relu_mlp"]


_ONEDNN_FROM = 64
"""Smallest batch for which oneDNN is faster: a call to it costs 10 microseconds more."""


class ReluMLP(MLP):
    """TorchRL's `MLP` with ReLU, `N = 1` of `relu_mlp`: same parameters, same outputs, faster.

    Args:
        in_features: Width of the (concatenated) input.
        out_features: Width of the output.
        num_cells: Widths of the hidden layers.
        device: Device of the parameters.
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
        # `vmap` cannot transform our operation, and autocast does not look into it.
        if torch._C._are_functorch_transforms_active() or autocast_enabled(inputs[0]):
            return super().forward(*inputs)
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

    Differentiable with respect to all arguments. With `create_graph=True` the gradient is computed
    by torch's own operations, layer by layer, and can be differentiated again. Under `torch.autocast`
    so is the output.

    Args:
        inputs: Inputs of the first layer, concatenated there, the same for all networks, `[P, d_i]`;
            converted to the weights' dtype.
        weights: One `[N, out_l, in_l]` per layer.
        biases: One `[N, out_l]` per layer.

    Returns:
        Outputs, `[N, P, out]`.
    """
    parameters = [tensor for layer in zip(weights, biases, strict=True) for tensor in layer]
    if autocast_enabled(inputs[0]):
        return _layers(inputs, weights, biases)[-1]
    inputs = [x.to(weights[0].dtype) for x in inputs]
    if torch.is_grad_enabled():
        return _ReluMLP.apply(len(inputs), *inputs, *parameters)
    x = _first_layer_input(inputs, parameters[0])
    multiply = _products(x)
    for index in range(0, len(parameters), 2):
        last = index + 2 == len(parameters)
        x = multiply.layer(x, parameters[index], parameters[index + 1], relu=not last)
    return multiply.stacked(x)


def autocast_enabled(x: Tensor) -> bool:
    """Whether `torch.autocast` is on for a tensor's device."""
    # Devices without autocast, such as "meta", raise where they are asked.
    device = x.device.type
    return torch.amp.is_autocast_available(device) and torch.is_autocast_enabled(device)


def _layers(
    inputs: Sequence[Tensor], weights: Sequence[Tensor], biases: Sequence[Tensor]
) -> list[Tensor]:
    """Each layer's input, `[N, P, in_l]`, then the output, by operations that autograd knows."""
    x = _first_layer_input(inputs, weights[0])
    layers = [x]
    for index, (weight, bias) in enumerate(zip(weights, biases, strict=True)):
        x = plain_linear(x, weight, bias)
        x = x.relu() if index + 1 < len(weights) else x
        layers.append(x)
    return layers


def plain_linear(x: Tensor, weight: Tensor, bias: Tensor) -> Tensor:
    """`N` linear layers; under autocast the bias is added in single precision, as with `vmap`."""
    return torch.bmm(x, weight.mT) + bias.unsqueeze(1)


def _first_layer_input(inputs: Sequence[Tensor], weight: Tensor) -> Tensor:
    """`[N, P, in]`, the same memory for all networks."""
    x = inputs[0] if len(inputs) == 1 else torch.cat(list(inputs), -1)
    return x.expand(weight.shape[0], *x.shape)


class _ReluMLP(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, num_inputs: int, *tensors: Tensor) -> Tensor:
        inputs, parameters = tensors[:num_inputs], tensors[num_inputs:]
        x: Any = _first_layer_input(inputs, parameters[0])
        ctx.multiply = multiply = _products(x)
        ctx.hidden = []  # nothing else holds these tensors, so `save_for_backward` is not needed
        for index in range(0, len(parameters), 2):
            ctx.hidden.append(x)
            last = index + 2 == len(parameters)
            x = multiply.layer(x, parameters[index], parameters[index + 1], relu=not last)
        # The biases are needed by second derivatives only; like the weights, they cost no memory.
        ctx.save_for_backward(*inputs, *parameters[::2], *parameters[1::2])
        ctx.num_inputs = num_inputs
        return multiply.stacked(x)

    @staticmethod
    def backward(ctx: Any, grad: Tensor) -> tuple[Tensor | None, ...]:
        saved, num_inputs = ctx.saved_tensors, ctx.num_inputs
        inputs, parameters = saved[:num_inputs], saved[num_inputs:]
        weights, biases = parameters[: len(parameters) // 2], parameters[len(parameters) // 2 :]
        multiply, hidden = ctx.multiply, ctx.hidden
        if torch.is_grad_enabled():  # create_graph=True: the gradient depends on all of these
            multiply, hidden = _DifferentiableProducts, _layers(inputs, weights, biases)[:-1]
        first = 1 + len(inputs)  # of the parameters among the arguments
        grads: list[Tensor | None] = [None] * (first + 2 * len(weights))
        for layer in reversed(range(len(weights))):
            weight, bias = first + 2 * layer, first + 2 * layer + 1
            if ctx.needs_input_grad[weight]:
                grads[weight] = multiply.weight_gradient(grad, hidden[layer])
            if ctx.needs_input_grad[bias]:
                grads[bias] = multiply.bias_gradient(grad)
            if layer:
                grad = multiply.input_gradient(grad, weights[layer], relu_output=hidden[layer])
        # An actor's step needs the action's gradient only, not the observation's.
        columns = weights[0].split([x.shape[-1] for x in inputs], dim=-1)
        for index, weight in enumerate(columns):
            if ctx.needs_input_grad[1 + index]:
                grads[1 + index] = multiply.stacked(multiply.input_gradient(grad, weight)).sum(0)
        return tuple(grads)


class _TorchProducts:
    """All networks at once, `[N, P, d]`, on any device and in any dtype."""

    @staticmethod
    def layer(x: Tensor, weight: Tensor, bias: Tensor, *, relu: bool) -> Tensor:
        x = torch.baddbmm(bias.unsqueeze(1), x, weight.mT)
        return x.relu_() if relu else x

    @staticmethod
    def weight_gradient(grad: Tensor, x: Tensor) -> Tensor:
        return torch.bmm(grad.mT, x)

    @staticmethod
    def bias_gradient(grad: Tensor) -> Tensor:
        return grad.sum(1)

    @staticmethod
    def input_gradient(grad: Tensor, weight: Tensor, relu_output: Tensor | None = None) -> Tensor:
        grad = torch.bmm(grad, weight)
        return grad if relu_output is None else _through_relu(grad, relu_output)

    @staticmethod
    def stacked(x: Tensor) -> Tensor:
        return x


class _DifferentiableProducts(_TorchProducts):
    """The same for gradients that are differentiated again: nothing is overwritten."""

    @staticmethod
    def input_gradient(grad: Tensor, weight: Tensor, relu_output: Tensor | None = None) -> Tensor:
        grad = torch.bmm(grad, weight)
        return (
            grad if relu_output is None else torch.ops.aten.threshold_backward(grad, relu_output, 0)
        )


class _OneDNNProducts:
    """Network by network, as lists of `N` matrices `[P, d]`: single precision on CPU."""

    @staticmethod
    def layer(x: Sequence[Tensor], weight: Tensor, bias: Tensor, *, relu: bool) -> Sequence[Tensor]:
        x = [_onednn_linear(*network) for network in zip(x, weight, bias, strict=True)]
        # Not oneDNN's own ReLU, which turns NaN into zero.
        return [y.relu_() for y in x] if relu else x

    @staticmethod
    def weight_gradient(grad: Sequence[Tensor], x: Sequence[Tensor]) -> Tensor:
        if grad[0].shape[-1] <= x[0].shape[-1]:
            return _stack([_onednn_linear(g.mT, a.mT) for g, a in zip(grad, x, strict=True)])
        # The narrower side first: up to two thirds faster for a first layer. With equal sides the copy
        # of a transposed matrix would cost more than it saves.
        transposed = [_onednn_linear(a.mT, g.mT) for g, a in zip(grad, x, strict=True)]
        return _stack([matrix.mT for matrix in transposed])

    @staticmethod
    def bias_gradient(grad: Sequence[Tensor]) -> Tensor:
        return _stack([g.sum(0) for g in grad])

    @staticmethod
    def input_gradient(
        grad: Sequence[Tensor], weight: Tensor, relu_output: Sequence[Tensor] | None = None
    ) -> Sequence[Tensor]:
        grad = [_onednn_linear(g, w.mT) for g, w in zip(grad, weight, strict=True)]
        if relu_output is None:
            return grad
        return [_through_relu(g, a) for g, a in zip(grad, relu_output, strict=True)]

    @staticmethod
    def stacked(x: Sequence[Tensor]) -> Tensor:
        return _stack(x)


def _stack(tensors: Sequence[Tensor]) -> Tensor:
    """Without a copy where there is nothing to stack."""
    return torch.stack(tuple(tensors)) if len(tensors) > 1 else tensors[0].unsqueeze(0)


def _products(x: Tensor) -> Any:
    plain = x.device.type == "cpu" and x.dtype == torch.float32 and x.shape[1] >= _ONEDNN_FROM
    if plain and not torch.compiler.is_compiling() and _onednn_is_faster():
        return _OneDNNProducts
    return _TorchProducts


@cache
def _onednn_is_faster() -> bool:
    # A rule, not a measurement: which library runs decides the last bits of every result, and two
    # runs on one machine have to agree in them.
    return (
        torch.backends.mkldnn.is_available()
        and torch.backends.cpu.get_cpu_capability() == "AVX512"
        and hasattr(torch.ops.mkldnn, "_linear_pointwise")
    )


def _onednn_linear(x: Tensor, weight: Tensor, bias: Tensor | None = None) -> Tensor:
    """`x @ weight.mT + bias`."""
    return torch.ops.mkldnn._linear_pointwise(_dense(x), _dense(weight), bias, "none", [], "")


def _dense(x: Tensor) -> Tensor:
    # For a matrix with gaps oneDNN has a reference implementation only, a hundred times slower.
    return x if x.is_contiguous() or x.mT.is_contiguous() else x.contiguous()


def _through_relu(grad: Tensor, output: Tensor) -> Tensor:
    """Gradient before a ReLU with this output; overwrites `grad`."""
    return torch.ops.aten.threshold_backward.grad_input(grad, output, 0, grad_input=grad)
