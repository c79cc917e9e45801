"""The side of training that learns: agent, replay buffer and updates."""

import copy
import math
import random
from collections import defaultdict
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from tensordict import NestedKey, TensorDict, TensorDictBase
from tensordict.nn import TensorDictModule
from torch import Tensor
from torch.optim.swa_utils import AveragedModel, get_ema_multi_avg_fn
from torchrl.objectives import LossModule

from modpush.agents.tqc.build import make_tqc_from_specs
from modpush.replay.attentive import AttentiveSampler
from modpush.replay.buffer import (
    buffer_state,
    load_buffer_state,
    make_replay_buffer,
    update_priorities,
)
from modpush.replay.mirror import MirrorTransitions
from modpush.replay.n_step import extend_rollout, forget_open_steps, n_step_transforms
from modpush.training.config import TrainConfig, learner_parts, replay_parts
from modpush.training.scene_worker import Rollout, WorkerSpecs


class NonFiniteLossError(RuntimeError):
    """A loss is NaN or infinite, so that all further training would be worthless."""


ZERO_INIT_ENTRIES = {"latent", "path_ahead"}
"""Entries whose weights begin at zero with `TrainConfig.zero_init_latent`."""


class Learner:
    """Agent and replay buffer, paced by environment steps.

    A batch with a loss that is not finite is saved in `folder`.
    """

    def __init__(
        self,
        config: TrainConfig,
        specs: WorkerSpecs,
        parts: Mapping[str, Any],
        folder: Path,
    ) -> None:
        # NumPy's and Python's for samplers that draw from them, such as TorchRL's prioritized one.
        torch.manual_seed(config.seed)
        np.random.seed(config.seed % 2**32)  # noqa: NPY002
        random.seed(config.seed)
        self.config, self.folder = config, folder
        self.observation_dim: int = specs.observation["observation"].shape[-1]
        self.agent = make_tqc_from_specs(
            config.tqc, specs.observation, specs.action, **learner_parts(config, parts)
        )
        if config.zero_init_latent:
            for name in ZERO_INIT_ENTRIES & specs.columns.keys():
                zero_input_weights(self.agent.loss, specs.columns[name])
        self._average: AveragedModel | None = None  # it copies the actor
        if config.actor_average > 0:
            average = get_ema_multi_avg_fn(config.actor_average)
            self._average = AveragedModel(self.agent.actor, multi_avg_fn=average)
        self.buffer = make_replay_buffer(config.filled_replay(), **replay_parts(parts))
        if config.mirror:
            self.buffer.append_transform(MirrorTransitions())
        self.learn_from = config.tqc.learning_starts
        """Environment steps after which updates are made."""
        self.updates = 0
        self.pending_updates = 0.0
        """Updates that are due but not made, less than one."""
        self._source = 0
        self._open_steps: dict[int, list[TensorDictBase | None]] = {}
        """Transitions that wait for their n-step returns, by collector, except the current one."""
        self._present: dict[int, Tensor] = {}
        """Observations that the scenes are in, by collector."""
        self.metrics: dict[str, list[float]] = defaultdict(list)
        """Values that the updates reported since the log was last written, by name."""

    def actor_weights(self) -> dict[str, NDArray]:
        """`state_dict` of the actor that acts as arrays."""
        return weights_of(self.agent.actor)

    @property
    def averaged_actor(self) -> TensorDictModule:
        """The actor that is evaluated: with averaged weights if the config says so."""
        if self._average is None or self._average.n_averaged == 0:
            return self.agent.actor
        return self._average.module

    def state(self) -> dict[str, Any]:
        """Weights, optimizer, buffer and pace for a checkpoint, as tensors and plain data."""
        return {
            "loss": dict(self.agent.loss.state_dict()),
            "average": None if self._average is None else dict(self._average.state_dict()),
            "optimizer": self.agent.optimizer.state_dict(),
            "buffer": buffer_state(self.buffer) if self.config.save_buffer else None,
            "updates": self.updates,
            "pending_updates": self.pending_updates,
            "metrics": dict(self.metrics),
        }

    def load_state(self, state: Mapping[str, Any]) -> None:
        """Take over a checkpoint, which holds the result of `state` and the run's `"steps"`."""
        self.agent.loss.load_state_dict(state["loss"])
        if self._average is not None and state["average"] is not None:
            self._average.load_state_dict(state["average"])
        self.agent.optimizer.load_state_dict(copy.deepcopy(state["optimizer"]))
        if state["buffer"] is not None:
            load_buffer_state(self.buffer, state["buffer"])
        else:  # nothing has been written to the buffer yet
            self.learn_from = state["steps"] + self.config.tqc.learning_starts
        self.updates, self.pending_updates = state["updates"], state["pending_updates"]
        self.metrics.update(state["metrics"])

    def store(self, rollout: Rollout) -> int:
        """Put a rollout's transitions into the buffer; returns how many there were."""
        transitions = self._transitions(rollout.transitions)
        count = len(transitions)
        self._select_open_steps(rollout)
        extend_rollout(self.buffer, transitions, self.config.env.num_envs)
        if rollout.hindsight:
            self.buffer.extend(self._transitions(rollout.hindsight))
        if self.config.replay.num_queries is None and isinstance(
            self.buffer.sampler, AttentiveSampler
        ):
            self._present[rollout.source] = torch.from_numpy(rollout.last_observation)
            self.buffer.sampler.set_query(torch.cat([*self._present.values()]))
        return count

    def _transitions(self, arrays: Mapping[NestedKey, NDArray]) -> TensorDict:
        """Transitions `[N]` of arrays by key."""
        transitions = TensorDict({}, batch_size=[len(arrays["action"])])
        for key, value in arrays.items():
            transitions.set(key, torch.from_numpy(value))
        return transitions.to(self.config.replay.device)

    def _select_open_steps(self, rollout: Rollout) -> None:
        """Select the transitions of a rollout's collector that wait for their n-step returns."""
        transforms = n_step_transforms(self.buffer)
        if rollout.source != self._source:
            self._open_steps[self._source] = [transform.waiting for transform in transforms]
            waiting = self._open_steps.pop(rollout.source, [None] * len(transforms))
            for transform, steps in zip(transforms, waiting, strict=True):
                transform.waiting = steps
            self._source = rollout.source
        if rollout.begins:
            forget_open_steps(self.buffer)

    def forget_open_steps(self) -> None:
        """Drop transitions that wait for their n-step returns, since the scenes were reset."""
        self._open_steps.clear()
        forget_open_steps(self.buffer)

    def learn(self, before: int, now: int) -> None:
        """Make the updates that are due after the environment steps from `before` to `now`.

        Raises:
            NonFiniteLossError: After the batch was saved.
        """
        starts = self.learn_from
        # The last steps of each scene wait for their n-step returns and may be missing in the buffer.
        if now <= starts or len(self.buffer) < self.config.sampled_from:
            return
        self.pending_updates += (now - max(before, starts)) * self.config.tqc.updates_per_step
        count, self.pending_updates = int(self.pending_updates), self.pending_updates % 1.0
        for _ in range(count):
            batch = self.buffer.sample()
            try:
                result = self.agent.update(batch.to(self.config.tqc.device))
            except ValueError as error:
                if all(value.isfinite().all() for value in batch.values(True, True)):
                    raise
                raise self._not_finite(str(error), batch, now) from error
            self.updates += 1
            if self._average is not None:
                self._average.update_parameters(self.agent.actor)
            update_priorities(self.buffer, batch, result)
            self._note(result, batch, now)

    def _note(self, result: TensorDictBase, batch: TensorDictBase, step: int) -> None:
        for name, entry in result.items():
            if entry.numel() != 1:  # priorities
                continue
            value = float(entry)
            if not math.isfinite(value):
                raise self._not_finite(f"{name} is {value}", batch, step)
            self.metrics[f"learner/{name}"].append(value)
        if "similarity" in batch.keys():
            self.metrics["learner/similarity"].append(float(batch["similarity"].mean()))

    def _not_finite(self, what: str, batch: TensorDictBase, step: int) -> NonFiniteLossError:
        """The error of a batch, which is saved for inspection."""
        path = self.folder / "non_finite_batch.pt"
        where = f"the batch is in {path}"
        try:
            torch.save(batch.to_dict(), path)
        except (OSError, RuntimeError) as error:  # torch's writer raises RuntimeError
            where = f"the batch could not be saved ({error})"
        return NonFiniteLossError(
            f"Trainer: {what} at update {self.updates}, step {step}; {where}, the newest checkpoint "
            "is from before."
        )


def weights_of(actor: TensorDictModule) -> dict[str, NDArray]:
    """An actor's `state_dict` as arrays."""
    state = actor.state_dict()
    return {name: value.detach().cpu().numpy().copy() for name, value in state.items()}


@torch.no_grad()
def zero_input_weights(loss: LossModule, columns: slice) -> None:
    """Set the weights of some columns of the observation to zero, in all first layers of a loss.

    The observation comes first in the inputs of actor and critics.
    """
    kinds = ("actor_network_params", "qvalue_network_params")
    names = [f"{which}{kind}" for which in ("", "target_") for kind in kinds]
    own = dict(loss.named_children())
    for networks in (own[name] for name in names if name in own):
        first = next(
            value
            for key, value in networks.items(True, True)
            if value.ndim > 1 and "encoder" not in key  # a convolution's columns are pixels
        )
        first.data[..., columns] = 0.0
