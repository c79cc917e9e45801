"""`TQCLoss`: TorchRL's results, with batched critics and a quantile-Huber loss in closed form."""

import pickle
import warnings
from collections.abc import Mapping
from contextlib import AbstractContextManager, nullcontext
from typing import Any, Self

import torch
from tensordict import TensorDictBase
from tensordict.nn import dispatch
from tensordict.utils import NestedKey, unravel_key
from torch import Tensor
from torchrl.envs.utils import ExplorationType, set_exploration_type
from torchrl.objectives import LossModule, TQCLoss as _TorchRLTQCLoss
from torchrl.objectives.sac import compute_rsample_log_prob
from torchrl.objectives.utils import ValueEstimators
from torchrl.objectives.value import TD0Estimator

from modpush._checks import check_dtype, read_key
from modpush._types import Fraction
from modpush._validation import check_value
from modpush.agents.tqc.ensemble import BatchedEnsemble, NotBatchableError
from modpush.agents.tqc.quantiles import quantile_huber, truncate_atoms


class TQCLoss(_TorchRLTQCLoss):
    """Truncated Quantile Critics loss, a drop-in for `torchrl.objectives.TQCLoss`.

    The constructor, keys, outputs, random draws and results are TorchRL's, and everything that
    works with its loss works with this one (`SoftUpdate`, `make_value_estimator`, `set_keys`,
    `SACTrainer`, prioritized weights, every reduction). It computes them
    differently: the critics are one batched matrix product per layer, and the quantile-Huber loss
    has its gradient in closed form, in compiled code on CPU.

    Critics that `BatchedEnsemble` cannot batch (anything but a multilayer perceptron) take
    TorchRL's path, about which one `UserWarning` is given at construction. So do target computations
    with `skip_done_states` or with averaged rewards, and everything under `torch.autocast`: exact, but
    slower.

    `loss_qvalue` is a mean over atoms and a *sum* over critics, as in TorchRL; sb3-contrib takes
    the mean over both.

    Raises:
        KeyError: In a call, if the batch lacks a key, with those it has.
        ValueError: At construction, if as many or more atoms are dropped than the critics hold. In a
            call on CPU, if the loss is not finite because the batch holds NaN or infinite values
            (TorchRL returns NaN); on a GPU this check would stall the device, and the loss is
            returned as it is.

    Source: Kuznetsov et al. (2020), arXiv 2005.04269; TorchRL's `TQCLoss` is the reference.
    """

    _warned = False

    def _make_vmap(self) -> None:
        # TorchRL's hook for what it calls critics through; the base constructor runs it once the
        # parameters are in place, and `set_vmap_randomness` again.
        super()._make_vmap()
        self._ensemble: BatchedEnsemble | None = None
        try:
            self._ensemble = BatchedEnsemble(self.qvalue_network)
        except NotBatchableError as reason:
            if not self._warned:
                warnings.warn(
                    f"TQCLoss: these critics cannot be batched ({reason}), so TorchRL's own loss is "
                    "computed: the same, but slower.",
                    UserWarning,
                    stacklevel=4,
                )
            self._warned = True  # `set_vmap_randomness` comes here again
            return
        if self.top_quantiles_to_drop_per_net >= self._ensemble.num_atoms:
            raise ValueError(
                "TQCLoss: top_quantiles_to_drop_per_net must be smaller than the critic's number "
                f"of quantiles (its last dimension, {self._ensemble.num_atoms}), got "
                f"{self.top_quantiles_to_drop_per_net}."
            )

    def make_value_estimator(self, value_type: Any = None, **hyperparams: Any) -> LossModule | None:
        """Set the value estimator, which must be TD(0).

        Args:
            value_type: TorchRL's `ValueEstimators.TD0`, or a `TD0Estimator`.
            **hyperparams: The estimator's, such as `gamma`.

        Raises:
            NotImplementedError: For any other estimator: targets are atoms, of which only TD(0)
                takes several per transition. `NStepTransform` makes n-step returns.
        """
        kind = value_type if isinstance(value_type, type) else type(value_type)
        names = (None, ValueEstimators.TD0, ValueEstimators.TD0.name)
        if value_type not in names and not issubclass(kind, TD0Estimator):
            raise NotImplementedError(
                f"TQCLoss: the value estimator must be TD(0), got {value_type!r}. For n-step "
                "returns, let the replay buffer sum the rewards (ReplayConfig(n_steps=...))."
            )
        gamma = hyperparams.get("gamma", 0.0)  # checked alone: where none is given, 0 passes
        if isinstance(gamma, Tensor) and gamma.numel() == 1:
            gamma = gamma.item()
        check_value("gamma", gamma, Fraction)
        return super().make_value_estimator(value_type, **hyperparams)

    @dispatch
    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Losses of a batch `[*B]`; the priorities are written into it."""
        widths = {key: read_key(tensordict, key).shape[-1] for key in self._required_keys()}
        self._check_widths(widths)
        return super().forward(tensordict)

    def _check_widths(self, widths: Mapping[NestedKey, int]) -> None:
        """Raise if critics or actor would get inputs of another width than they take."""
        keys = self.qvalue_network.in_keys
        if self._ensemble is not None:
            expected, inputs = self._ensemble.num_inputs, {key: widths[key] for key in keys}
            if sum(inputs.values()) != expected:
                raise ValueError(
                    f"TQCLoss: the critics take {expected} numbers, got the last dimensions {inputs}."
                )
        for key in keys:
            following = unravel_key(("next", key))
            if widths.get(following, widths[key]) != widths[key]:
                raise ValueError(
                    f"TQCLoss: {following!r} must be [..., {widths[key]}] as {key!r}, got "
                    f"[..., {widths[following]}]."
                )

    def _required_keys(self) -> list[NestedKey]:
        keys = self.tensor_keys
        inputs = {*self.actor_network.in_keys, *self.qvalue_network.in_keys}
        following = [*(inputs - {keys.action}), keys.reward, keys.terminated]
        return [*inputs, keys.action, *(unravel_key(("next", key)) for key in following)]

    def qvalue_v2_loss(self, tensordict: TensorDictBase) -> tuple[Tensor, dict[str, Tensor]]:
        """Critic loss, and under `"td_error"` the priorities `[*B]`."""
        if self._takes_torchrls_path():
            return super().qvalue_v2_loss(tensordict)
        weights = self._maybe_get_priority_weight(tensordict)
        targets = self.compute_target(tensordict)
        quantiles = self._atoms(tensordict, self.qvalue_network_params)  # [N, *B, n]
        dtype = torch.promote_types(quantiles.dtype, targets.dtype)  # rewards may be doubles
        loss, td_error = quantile_huber(quantiles.to(dtype), targets.to(dtype))
        loss = self._reduce_loss(loss.sum(0), tensordict=tensordict, weights=weights)
        if loss.device.type == "cpu" and not torch.compiler.is_compiling():
            self._check_finite(loss, tensordict)
        return loss, {"td_error": td_error.max(0).values}

    def actor_loss(self, tensordict: TensorDictBase) -> tuple[Tensor, dict[str, Tensor]]:
        """Actor loss, and under `"log_prob"` the new actions' log-probabilities `[*B]`."""
        if self._takes_torchrls_path():
            return super().actor_loss(tensordict)
        weights = self._maybe_get_priority_weight(tensordict)
        action, log_prob = self._draw_action(tensordict)
        quantiles = self._atoms(tensordict, self._cached_detached_qvalue_params, action)
        # Policy gradients use the whole mixture; only Bellman targets are cut.
        value = quantiles.mean(dim=(0, -1))
        if log_prob.shape != value.shape:
            raise RuntimeError(
                "TQCLoss: the actor's log-probability must have the batch's shape "
                f"{tuple(value.shape)}, got {tuple(log_prob.shape)}."
            )
        loss = self._alpha * log_prob - value
        loss = self._reduce_loss(loss, tensordict=tensordict, weights=weights)
        return loss, {"log_prob": log_prob.detach()}

    def __getstate__(self) -> dict[str, Any]:
        # Functions cannot be pickled, and what is cached would belong to the original.
        derived = ("_vmap_qnetworkN0", "_ensemble", "_cache")
        return {key: value for key, value in self.__dict__.items() if key not in derived}

    def __setstate__(self, state: dict[str, Any]) -> None:
        super().__setstate__(state)
        self._make_vmap()

    def __deepcopy__(self, memo: dict[int, Any]) -> Self:
        # TensorDictParams copies itself without the memo, so that what the loss and its networks share
        # would be copied for each. The memo lets an optimizer that is copied along follow.
        other = pickle.loads(pickle.dumps(self))
        memo.update(zip(map(id, self.parameters()), other.parameters(), strict=True))
        return other

    @torch.no_grad()
    def compute_target(self, tensordict: TensorDictBase) -> Tensor:
        """Truncated Bellman targets in ascending order, `[*B, N * n - N * dropped]`."""
        estimator = self.value_estimator
        plain = type(estimator) is TD0Estimator and not estimator.average_rewards
        if self._takes_torchrls_path() or self.skip_done_states or not plain:
            return super().compute_target(tensordict)
        next_tensordict = tensordict.get("next")
        action, log_prob = self._draw_action(next_tensordict)
        atoms = self._atoms(next_tensordict, self.target_qvalue_network_params, action)
        num_dropped = self.top_quantiles_to_drop_per_net * self.num_qvalue_nets
        value = truncate_atoms(atoms, num_dropped) - self._alpha * log_prob.unsqueeze(-1)
        reward = _to_ndim(next_tensordict.get(self.tensor_keys.reward), value.ndim)
        terminated = _to_ndim(next_tensordict.get(self.tensor_keys.terminated), value.ndim)
        check_dtype(repr(self.tensor_keys.terminated), terminated, torch.bool)
        gamma = estimator.gamma.to(reward.device)
        steps = tensordict.get(estimator.tensor_keys.steps_to_next_obs, None)
        if steps is not None:  # n-step returns, as `MultiStepTransform` writes them
            gamma = gamma ** _to_ndim(steps, value.ndim)
        return reward + gamma * (~terminated).int() * value

    def _takes_torchrls_path(self) -> bool:
        device = self.log_alpha.device.type  # devices without autocast raise where they are asked
        autocast = torch.amp.is_autocast_available(device) and torch.is_autocast_enabled(device)
        return self._ensemble is None or autocast

    def _actor_parameters(self) -> AbstractContextManager[Any]:
        """A context in which the actor holds the loss's parameters, empty where it already does."""
        actor, params = self.actor_network, self.actor_network_params
        if {*actor.parameters()} == {*params.parameters()}:
            return nullcontext()
        return params.to_module(actor, preserve_module_state=False)

    def _draw_action(self, tensordict: TensorDictBase) -> tuple[Tensor, Tensor]:
        """An action of the present policy, `[*B, A]`, and its log-probability, `[*B]`."""
        inputs = tensordict.select(*self.actor_network.in_keys, strict=False)
        with set_exploration_type(ExplorationType.RANDOM), self._actor_parameters():
            return compute_rsample_log_prob(self.actor_network.get_dist(inputs))

    def _atoms(
        self, tensordict: TensorDictBase, params: TensorDictBase, action: Tensor | None = None
    ) -> Tensor:
        """Atoms `[N, *B, n]` at the tensordict's action, or at the one given."""
        assert self._ensemble is not None
        inputs = [
            action if action is not None and key == self.tensor_keys.action else tensordict.get(key)
            for key in self._ensemble.in_keys
        ]
        return self._ensemble(inputs, params)

    def _check_finite(self, loss: Tensor, tensordict: TensorDictBase) -> None:
        """Raise if the loss is not finite because of a value in the batch."""
        if loss.isfinite().all():
            return
        reward = unravel_key(("next", self.tensor_keys.reward))
        for key in self.in_keys:
            value = tensordict.get(key, None)
            if value is None or not value.is_floating_point() or value.isfinite().all():
                continue
            hint = ""
            if isinstance(key, tuple) and key[0] == "next" and key != reward:
                hint = " If only the next states of terminal transitions do, pass skip_done_states=True."
            raise ValueError(
                f"TQCLoss: the batch holds NaN or infinite values under {key!r}, first at index "
                f"{(~value.isfinite()).nonzero()[0].tolist()}.{hint}"
            )


def _to_ndim(x: Tensor, ndim: int) -> Tensor:
    return x.reshape(*x.shape, *(1,) * (ndim - x.ndim))
