"""The training loop: scenes act while the learner learns from what they did before."""

import errno
import math
import shutil
import time
import warnings
from collections import defaultdict
from dataclasses import replace
from typing import Any

import pandas as pd
import torch
from tensordict import TensorDict, TensorDictBase
from torchrl.checkpoint import Checkpoint, GlobalRNGState
from tqdm import tqdm

from modpush.agents import TQCLoss
from modpush.agents.tqc.build import make_tqc_from_specs
from modpush.recipes.paper import save_agent
from modpush.replay import AttentiveSampler, make_replay_buffer
from modpush.training.config import TrainConfig
from modpush.training.log import RunLog
from modpush.training.run_folder import RunFolder
from modpush.training.worker import Chunk, LocalWorker, Specs, StartMethod, WorkerProcess

__all__ = ["NonFiniteLossError", "Trainer"]


class NonFiniteLossError(RuntimeError):
    """A loss is NaN or infinite: nothing that comes after would be worth anything."""


class Trainer:
    """One training run in a folder.

    A question to the worker is always one chunk ahead: while the learner learns from a chunk, the
    scenes act in the next with the weights from before. Taking turns has the very same order, so
    that both learn alike.

    Args:
        config: The run's.
        folder: From `check_run_folder`.
        resume: Go on from the folder's newest checkpoint.
        start_method: How the worker's process begins; see `WorkerProcess`.
    """

    def __init__(
        self,
        config: TrainConfig,
        folder: RunFolder,
        *,
        resume: bool = False,
        start_method: StartMethod = "spawn",
    ) -> None:
        self.config, self.folder = config, folder
        self.worker: LocalWorker | WorkerProcess = (
            WorkerProcess(config, start_method) if config.side_by_side else LocalWorker(config)
        )
        try:
            specs: Specs = self.worker.call("specs")
        except BaseException:
            self.worker.close()
            raise
        torch.manual_seed(config.seed)
        self.observation_dim = specs.observation["observation"].shape[-1]
        self.agent = make_tqc_from_specs(config.tqc, specs.observation, specs.action)
        if config.blind_start:
            _ignore(self.agent.loss, specs.latent)
        queries = config.replay.num_queries
        if config.replay.sampler == "attentive":
            queries = config.env.num_envs
        self.buffer = make_replay_buffer(replace(config.replay, num_queries=queries))
        self.steps, self.updates, self.checkpoints_made = 0, 0, 0
        self.owed = 0.0  # updates, not yet made up to a whole one
        self.seconds = 0.0  # of training, in sessions before this one
        self.best = (-1.0, -1.0)
        self.interrupted = False
        """Set it, from a signal's handler say, to end the run as Ctrl-C does after this chunk."""
        self._curriculum: dict[str, Any] = {}
        if resume:
            self._load()
        folder.write_config(config)
        self.log = RunLog(config, folder, resumed_at=self.steps if resume else None)
        self._began = time.perf_counter() - self.seconds
        self._since: dict[str, list[float]] = defaultdict(list)
        self._mark = (self._began + self.seconds, self.steps, self.updates)

    # ------------------------------------------------------------------ the loop

    def run(self) -> dict[str, float]:
        """Train until `total_steps`, or Ctrl-C.

        Returns:
            Success and contact of the best evaluation; -1 before the first.

        Raises:
            KeyboardInterrupt: After a checkpoint was written.
            NonFiniteLossError: After the batch was saved for inspection.
        """
        config = self.config
        self._start_scenes()
        bar = tqdm(
            total=config.total_steps,
            initial=self.steps,
            unit="step",
            disable=not config.progress,
            smoothing=0.02,
        )
        try:
            self._ask()
            while self.steps < config.total_steps:
                if self.interrupted:
                    raise KeyboardInterrupt
                chunk: Chunk = self.worker.answer()
                before = self.steps
                self._store(chunk)
                bar.update(self.steps - before)
                due = {
                    name: self.steps // every > before // every or self.steps >= config.total_steps
                    for name, every in (
                        ("evaluate", config.evaluate_every),
                        ("checkpoint", config.checkpoint_every),
                        ("log", config.log_every),
                    )
                }
                pause = due["evaluate"] or due["checkpoint"]
                if not pause:
                    self._ask()
                self._learn(before)
                if due["log"]:
                    bar.set_postfix(self._write_log(chunk), refresh=False)
                if due["evaluate"]:
                    self._evaluate()
                if due["checkpoint"]:
                    self._save()
                if pause and self.steps < config.total_steps:
                    self._ask()
        except KeyboardInterrupt:
            bar.close()
            self._save_after_interrupt()
            raise
        finally:
            bar.close()
            self.close()
        return {"success": self.best[0], "contact": self.best[1]}

    def close(self) -> None:
        """End the worker and the logs."""
        self.worker.close()
        self.log.close()

    def _start_scenes(self) -> None:
        if self._curriculum:
            self.worker.call("set_state", self._curriculum)
        self.worker.call("restart", self._seed())

    def _seed(self) -> int:
        # Scene i takes seed + i: far enough apart for the scenes of any two runs and restarts.
        return 1_000_003 * (self.config.seed + 1) + 10_007 * self.checkpoints_made

    def _ask(self) -> None:
        if self.steps < self.config.tqc.learning_starts:
            weights = None
        else:
            weights = self._actor_weights()
        self.worker.ask("collect", self.config.chunk, weights)

    def _actor_weights(self) -> dict[str, Any]:
        state = self.agent.actor.state_dict()
        return {name: value.detach().cpu().numpy().copy() for name, value in state.items()}

    def _store(self, chunk: Chunk) -> None:
        count = len(chunk.transitions["action"])
        transitions = TensorDict({}, batch_size=[count])
        for key, value in chunk.transitions.items():
            transitions.set(key, torch.from_numpy(value))
        self.buffer.extend(transitions.to(self.config.replay.device))
        if isinstance(self.buffer.sampler, AttentiveSampler):
            self.buffer.sampler.set_query(torch.from_numpy(chunk.present))
        self.steps += count
        for episode in chunk.episodes:
            kind = "greedy" if episode["greedy"] else "noisy"
            for name in ("success", "contact", "collision", "steps", "return", "out_of_bounds"):
                self._since[f"{kind}/{name}"].append(episode[name])

    def _learn(self, before: int) -> None:
        if self.steps <= self.config.tqc.learning_starts:
            return
        fresh = self.steps - max(before, self.config.tqc.learning_starts)
        self.owed += fresh * self.config.tqc.updates_per_step
        count, self.owed = int(self.owed), self.owed % 1.0
        for _ in range(count):
            batch = self.buffer.sample()
            result = self.agent.update(batch.to(self.config.tqc.device))
            self.updates += 1
            self._note(result, batch)

    def _note(self, result: TensorDictBase, batch: TensorDictBase) -> None:
        for name in ("loss_actor", "loss_qvalue", "loss_alpha", "alpha", "entropy"):
            value = float(result[name])
            if not math.isfinite(value):
                path = self.folder.path / "non_finite_batch.pt"
                torch.save(batch.to_dict(), path)
                raise NonFiniteLossError(
                    f"Trainer: {name} is {value} at update {self.updates}, step {self.steps}; the "
                    f"batch is in {path}, the newest checkpoint is from before."
                )
            self._since[f"learner/{name}"].append(value)
        if "similarity" in batch.keys():
            self._since["learner/similarity"].append(float(batch["similarity"].mean()))

    # ------------------------------------------------------------------ beside it

    def _write_log(self, chunk: Chunk) -> dict[str, str]:
        now, (then, steps, updates) = time.perf_counter(), self._mark
        self._mark = (now, self.steps, self.updates)
        row = {name: sum(seen) / len(seen) for name, seen in self._since.items() if seen}
        self._since.clear()
        row |= {f"family/{name}": value for name, value in chunk.families.items()}
        row["curriculum/level"] = float(chunk.level)
        row["speed/steps"] = (self.steps - steps) / (now - then)
        row["speed/updates"] = (self.updates - updates) / (now - then)
        row["minutes"] = (now - self._began) / 60
        row["updates"] = float(self.updates)
        self.log.write(self.steps, row)
        return {
            "success": f"{row.get('greedy/success', row.get('noisy/success', 0.0)):.2f}",
            "level": str(chunk.level),
            "best": f"{max(self.best[0], 0.0):.3f}",
            "steps/s": f"{row['speed/steps']:.0f}",
            "updates/s": f"{row['speed/updates']:.0f}",
        }

    def _evaluate(self) -> None:
        rows = pd.DataFrame(self.worker.call("evaluate", self._actor_weights()))
        minutes = (time.perf_counter() - self._began) / 60
        summary = self.log.write_evaluation(self.steps, self.updates, minutes, rows)
        self._save_agent(self.folder.last_agent, summary)
        score = (summary["success"], summary["contact_rate"])
        if score > self.best:
            self.best = score
            self._save_agent(self.folder.best_agent, summary)

    def _save_agent(self, path: Any, summary: dict[str, float]) -> None:
        save_agent(
            path,
            self.agent.actor,
            self.config.env,
            hidden_sizes=self.config.tqc.hidden_sizes,
            observation_dim=self.observation_dim,
            metadata={
                "steps": self.steps,
                "updates": self.updates,
                "minutes": round((time.perf_counter() - self._began) / 60, 1),
                "seed": self.config.seed,
                "held_out": summary,
            },
        )

    # ------------------------------------------------------------------ checkpoints

    def _components(self) -> Checkpoint:
        parts: dict[str, Any] = {
            "loss": self.agent.loss,
            "optimizer": self.agent.optimizer,
            "rng": GlobalRNGState(),
        }
        if self.config.save_buffer:
            parts["buffer"] = self.buffer
        return Checkpoint(**parts)

    def _save(self) -> None:
        """Write a checkpoint, and begin new episodes: what resumes from it does the same."""
        self.checkpoints_made += 1
        self._curriculum = self.worker.call("get_state")
        metadata = {
            "steps": self.steps,
            "updates": self.updates,
            "checkpoints_made": self.checkpoints_made,
            "owed": self.owed,
            "seconds": time.perf_counter() - self._began,
            "best": list(self.best),
            "curriculum": self._curriculum,
        }
        # The worker's draws come from a seed of this checkpoint; restarting first makes the saved
        # random state the one that the run goes on with.
        self.worker.call("restart", self._seed())
        try:
            self._check_space()
            self.folder.checkpoints.save(self._components(), step=self.steps, metadata=metadata)
        except (OSError, RuntimeError) as error:  # torch's writer says RuntimeError
            warnings.warn(
                f"Trainer: the checkpoint at step {self.steps} could not be written ({error}); "
                "the one before stays, training goes on.",
                stacklevel=2,
            )

    def _check_space(self) -> None:
        # A memory-mapped buffer on a full disk would end the process, not raise.
        needed = 100_000_000
        if self.config.save_buffer and len(self.buffer):
            needed += len(self.buffer) * self.buffer[:1].bytes()
        free = shutil.disk_usage(self.folder.path).free
        if free < needed:
            raise OSError(
                errno.ENOSPC, f"{free / 1e6:.0f} MB are free, {needed / 1e6:.0f} MB are needed"
            )

    def _save_after_interrupt(self) -> None:
        # The worker may still be at a chunk: its answer is waited for and dropped.
        if self.worker.busy:
            self.worker.answer()
        self._save()

    def _load(self) -> None:
        checkpoint = self._components()
        latest = self.folder.checkpoints.latest()
        assert latest is not None, "check_run_folder has seen one"
        checkpoint.load(latest)
        metadata = checkpoint.manifest(latest)["metadata"]
        self.steps, self.updates = metadata["steps"], metadata["updates"]
        self.checkpoints_made, self.owed = metadata["checkpoints_made"], metadata["owed"]
        self.seconds, self.best = metadata["seconds"], tuple(metadata["best"])
        self._curriculum = metadata["curriculum"]


@torch.no_grad()
def _ignore(loss: TQCLoss, columns: slice) -> None:
    """Set the first layers' weights of some columns of the observation to zero."""
    for networks in (
        *(loss.actor_network_params, loss.qvalue_network_params),
        loss.target_qvalue_network_params,
    ):
        first = next(value for _, value in networks.items(True, True) if value.ndim > 1)
        first.data[..., columns] = 0.0
