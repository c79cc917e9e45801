"""Runners of a `SceneWorker`: in this process, or in a process of its own.

Both kinds of `Worker` take one method of `SceneWorker` at a time and give its result when asked, so
that the training loop is the same for both.
"""

import gc
import multiprocessing
import traceback
from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Any, Concatenate, Literal, ParamSpec, TypeVar

import torch

from modpush._processes import begin_worker_process
from modpush.agents.tqc.quantiles import quantile_huber
from modpush.training.scene_worker import SceneWorker

StartMethod = Literal["spawn", "fork"]
P = ParamSpec("P")
R = TypeVar("R")
MakeWorker = Callable[[], SceneWorker]


class CollectionEndedError(RuntimeError):
    """The scenes were lost through no fault of the run, which can continue from a checkpoint."""


class Worker(ABC):
    """Implement `_send`, `_receive` and `close`; the rest is what a caller uses."""

    _outstanding = False

    @abstractmethod
    def _send(self, method: Callable[..., Any], args: Any, kwargs: Any) -> None:
        """Submit a call."""

    @abstractmethod
    def _receive(self) -> Any:
        """Wait for the result of the submitted call."""

    @abstractmethod
    def close(self) -> None:
        """Free the simulators, and end the process if there is one."""

    def submit(
        self, method: Callable[Concatenate[SceneWorker, P], Any], *args: P.args, **kwargs: P.kwargs
    ) -> None:
        """Have a method of `SceneWorker` called: `worker.submit(SceneWorker.collect, 8, weights)`."""
        if self._outstanding:
            raise RuntimeError("Worker.submit: call `result` of the previous call first.")
        self._send(method, args, kwargs)
        self._outstanding = True

    def wait(self, seconds: float) -> bool:
        """Wait for the result, at most this many seconds; True if `result` then returns at once."""
        return True

    def result(self) -> Any:
        """Wait for the result of the last call; a RuntimeError if a worker process failed or ended."""
        try:
            result = self._receive()
        except Exception:
            self._outstanding = False
            raise
        self._outstanding = False  # not before: an interrupt may come while it waits
        return result

    def call(
        self, method: Callable[Concatenate[SceneWorker, P], R], *args: P.args, **kwargs: P.kwargs
    ) -> R:
        """Call a method of `SceneWorker`, and wait for its result."""
        self.submit(method, *args, **kwargs)
        result: R = self.result()
        return result

    def discard(self) -> None:
        """Wait for an outstanding result, if there is one, and drop it."""
        if self._outstanding:
            self.result()


class InlineWorker(Worker):
    """Calls the `SceneWorker` in this process, when the result is asked for.

    The worker draws from a random state of its own, as it would in a process of its own.
    """

    def __init__(self, make_worker: MakeWorker) -> None:
        self._random_state = torch.get_rng_state()
        self._call: tuple[Callable[..., Any], Any, Any] | None = None
        self._worker = self._with_own_random_state(make_worker)

    def _with_own_random_state(self, function: Callable[[], R]) -> R:
        """Call a function with the worker's random state in torch's place."""
        callers = torch.get_rng_state()
        torch.set_rng_state(self._random_state)
        try:
            return function()
        finally:
            self._random_state = torch.get_rng_state()
            torch.set_rng_state(callers)

    def _send(self, method: Callable[..., Any], args: Any, kwargs: Any) -> None:
        self._call = method, args, kwargs

    def _receive(self) -> Any:
        if self._call is None:
            raise RuntimeError("InlineWorker: there is no call to give the result of.")
        (method, args, kwargs), self._call = self._call, None
        return self._with_own_random_state(lambda: method(self._worker, *args, **kwargs))

    def close(self) -> None:
        """Free the simulators."""
        self._worker.close()


class ProcessWorker(Worker):
    """Calls the `SceneWorker` in a process of its own, while the caller does something else.

    `make_worker` must be picklable unless the process is forked. `"fork"` shares the libraries' memory
    with the caller, some 300 MB; it is only for a process that has made no simulator and has run nothing
    on several threads of torch or numba, since a fork copies their state without the threads.
    """

    def __init__(self, make_worker: MakeWorker, start_method: StartMethod = "spawn") -> None:
        context: Any = multiprocessing.get_context(start_method)
        if start_method == "fork":
            # Numba's compiler, 50 MB that both processes would else hold, starts at the first call.
            quantile_huber(torch.zeros(1, 1, 1), torch.zeros(1, 1))
            gc.collect()
            gc.freeze()  # a collection would write to, and so copy, every page with an object on it
        self._pipe, theirs = context.Pipe()
        # A forked worker holds our end of the pipe as well, and must close it to notice our end.
        ours = self._pipe if start_method == "fork" else None
        self._process = context.Process(
            target=_serve, args=(theirs, make_worker, ours), daemon=True
        )
        self._process.start()
        theirs.close()

    def _send(self, method: Callable[..., Any], args: Any, kwargs: Any) -> None:
        self._pipe.send((method, args, kwargs))

    def wait(self, seconds: float) -> bool:
        return self._pipe.poll(seconds)

    def _receive(self) -> Any:
        try:
            failed, result = self._pipe.recv()
        except EOFError:
            self._process.join(5)
            raise RuntimeError(
                f"ProcessWorker: the worker ended early, exit code {self._process.exitcode}."
            ) from None
        if failed:
            raise RuntimeError(f"ProcessWorker: the worker failed:\n{result}")
        return result

    def close(self) -> None:
        """End the process."""
        if self._process.is_alive():
            self._process.kill()  # it holds nothing that must be saved, and leaves signals to us
        self._process.join()
        self._pipe.close()


def _serve(pipe: Any, make_worker: MakeWorker, callers_end: Any = None) -> None:
    """The process's main function: make the worker at the first call, then answer calls."""
    if callers_end is not None:
        callers_end.close()
    begin_worker_process()
    # The other core is the learner's. Our kernels follow torch's number; numba's own setting would
    # put torch's back to all cores.
    torch.set_num_threads(1)
    worker: SceneWorker | None = None
    while True:
        try:
            method, args, kwargs = pipe.recv()
        except EOFError:  # the caller has ended
            return
        try:
            worker = make_worker() if worker is None else worker
            pipe.send((False, method(worker, *args, **kwargs)))
        except Exception:
            pipe.send((True, traceback.format_exc()))
