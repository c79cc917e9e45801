"""One optimisation step of TQC: losses, gradients, Adam, target networks."""

from collections.abc import Callable
from typing import Literal

import torch
from tensordict import TensorDict, TensorDictBase
from tensordict.nn import CudaGraphModule
from torchrl.objectives import LossModule
from torchrl.objectives.utils import TargetNetUpdater

from modpush._precision import Precision, networks_in
from modpush._validation import checked_arguments

Execution = Literal["eager", "compile", "cudagraph"]


class TQCUpdate:
    """A whole optimisation step as one call, which can be compiled or recorded as a CUDA graph.

    All losses are taken at the same parameters and their gradients are disjoint, so a single
    backward pass serves actor, critics and temperature, as in TorchRL's own trainers.

    Args:
        loss: A loss whose outputs named `loss_*` are to be minimised.
        optimizer: Over the loss's parameters; `capturable` for CUDA graphs.
        target_updater: Moves the loss's target networks after the optimizer's step; None for a
            loss that has none.
        execution: `"eager"`; `"compile"` with `torch.compile`; `"cudagraph"` (experimental), compiled and
            recorded as one CUDA graph: batches must keep their shape, and a batch's tensors are
            copied into the graph's own.
        precision: Of the library's networks on the CPU. With `"bfloat16"` their layers compute under
            `torch.autocast`, and sums within a product are float32; weights, their gradients,
            optimizer, targets and losses are float32 with both, as are actors of your own. Only
            processors with AMX or AVX512-BF16 gain by it. It has no effect on other devices.

    Raises:
        ValueError: If the execution or the precision is unknown, or the execution is `"cudagraph"`
            without a CUDA device.
    """

    @checked_arguments
    def __init__(
        self,
        loss: LossModule,
        optimizer: torch.optim.Optimizer,
        target_updater: TargetNetUpdater | None,
        *,
        execution: Execution = "eager",
        precision: Precision = "float32",
    ) -> None:
        device = next(loss.parameters()).device
        if execution == "cudagraph" and device.type != "cuda":
            raise ValueError(
                f"TQCUpdate: execution 'cudagraph' needs parameters on a CUDA device, got {device}."
            )
        self.loss = loss
        self.optimizer = optimizer
        self.target_updater = target_updater
        self.precision = precision
        self._step: Callable[[TensorDictBase], TensorDict] = self.step
        if execution != "eager":
            self._step = torch.compile(self.step)
        if execution == "cudagraph":
            self._step = CudaGraphModule(self._step, in_keys=None, out_keys=None)

    def __call__(self, batch: TensorDictBase) -> TensorDict:
        """Take one step.

        Args:
            batch: Transitions, `[B]`. The loss writes its priorities into it (into a copy in a
                CUDA graph: read them from the result).

        Returns:
            The losses and what else the loss reports, detached, and, if the loss writes them, the
            priorities under its priority key, `[B]`.

        Raises:
            KeyError: If the loss returns nothing that is named `loss_*`.
        """
        with networks_in(self.precision):
            return self._step(batch)

    def step(self, batch: TensorDictBase) -> TensorDict:
        """Take one step, always eager."""
        output = self.loss(batch)
        losses = [value for key, value in output.items() if key.startswith("loss_")]
        if not losses:
            raise KeyError(
                f"TQCUpdate: {type(self.loss).__name__} must return outputs named loss_*, it "
                f"returned {sorted(map(str, output.keys()))}."
            )
        torch.stack(losses).sum().backward()
        self.optimizer.step()
        self.optimizer.zero_grad()
        if self.target_updater is not None:
            self.target_updater.step()
        result = output.detach()
        key = getattr(self.loss.tensor_keys, "priority", None)
        priority = None if key is None else batch.get(key, None)
        return result if priority is None else result.set(key, priority)
