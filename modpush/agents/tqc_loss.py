"""TQC's loss: TorchRL's results at the price of its matrix products."""

import logging

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.objectives import TQCLoss as _TorchRLTQCLoss

from modpush.agents.ensemble import BatchedEnsemble, NotBatchable
from modpush.agents.quantile_huber import quantile_huber

__all__ = ["TQCLoss"]

_logger = logging.getLogger(__name__)


class TQCLoss(_TorchRLTQCLoss):
    def _make_vmap(self) -> None:
        super()._make_vmap()
        self._ensemble = None
        try:
            self._vmap_qnetworkN0 = self._ensemble = BatchedEnsemble(self.qvalue_network)
        except NotBatchable as reason:
            _logger.info("%s", reason)

    def qvalue_v2_loss(self, tensordict: TensorDictBase) -> tuple[Tensor, dict[str, Tensor]]:
        weights = self._maybe_get_priority_weight(tensordict)
        targets = self.compute_target(tensordict)
        critic_input = tensordict.select(*self.qvalue_network.in_keys, strict=False)
        critic_output = self._vmap_qnetworkN0(critic_input, self.qvalue_network_params)
        quantiles = critic_output.get(self.tensor_keys.state_action_value)
        loss, td_error = quantile_huber(quantiles, targets)
        loss = self._reduce_loss(loss.sum(0), tensordict=tensordict, weights=weights)
        return loss, {"td_error": td_error.max(0).values}
