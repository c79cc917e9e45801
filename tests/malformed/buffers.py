"""Replay buffers, samplers and storages, with right arguments."""

import math
from typing import Any

import torch
from tensordict import TensorDict
from torch import Tensor

from modpush import replay
from tests.malformed.target import BELOW_1, KEYS, NOT_FINITE, UNKNOWN, Target

CONFIG = replay.ReplayConfig(capacity=64, batch_size=4, k=2)


def transitions(count: int = 16) -> TensorDict:
    """Random ones, `[count]`."""
    flags = torch.zeros(count, 1, dtype=torch.bool)
    following = {"observation": torch.rand(count, 6), "reward": torch.rand(count, 1), "done": flags}
    now = {"observation": torch.rand(count, 6), "action": torch.rand(count, 2)}
    return TensorDict({**now, "next": {**following, "terminated": flags}}, [count])


def filled(**options: Any) -> Any:
    """A buffer with some transitions."""
    buffer = replay.make_replay_buffer(replay.ReplayConfig(**{**_options(), **options}))
    buffer.extend(transitions())
    return buffer


def _options() -> dict[str, Any]:
    return {"capacity": 64, "batch_size": 4, "k": 2}


def _sample(observation: Tensor) -> Any:
    buffer = filled()
    buffer.extend(transitions().set("observation", observation))
    return buffer.sample()


def _update_priorities(td_error: Tensor) -> None:
    buffer = filled(sampler="prioritized")
    replay.update_priorities(buffer, buffer.sample(), TensorDict({"td_error": td_error}))


def targets() -> list[Target]:
    """All of them."""
    return [*_makers(), *_use()]


def _makers() -> list[Target]:
    return [
        Target(
            name="AttentiveSampler",
            call=replay.AttentiveSampler,
            given=lambda: {
                "k": 2.0,
                "key": "observation",
                "similarity": "cosine",
                "num_queries": 1,
                "candidate_replacement": True,
                "k_end": 1.0,
                "annealing_num_samples": 5,
            },
            bad={
                "k": [0.5, 0.0, *NOT_FINITE],
                "key": KEYS,
                "similarity": [*UNKNOWN, 3],
                "num_queries": BELOW_1,
                "k_end": [0.5, *NOT_FINITE],
                "annealing_num_samples": [-1, 0],
            },
            may_be_none=["k_end", "num_queries"],
        ),
        Target(
            name="make_replay_buffer",
            call=replay.make_replay_buffer,
            given=lambda: {"config": CONFIG, "sampler": "uniform", "similarity": None},
            bad={
                "config": [None, {}, 3],
                "sampler": [*UNKNOWN, 3, dict],
                "similarity": ["cosine", 3],
            },
            only=["config", "sampler", "similarity"],
        ),
        Target(
            name="CompactStorage",
            call=replay.CompactStorage,
            given=lambda: {"max_size": 16, "keys": ("observation",), "device": "cpu"},
            bad={"max_size": BELOW_1, "keys": [(3,), ("",), 3], "device": ["", "no such"]},
        ),
        Target(
            name="NStepTransform",
            call=replay.NStepTransform,
            given=lambda: {"n_steps": 3, "gamma": 0.9},
            bad={"n_steps": BELOW_1, "gamma": [-0.1, 1.1, *NOT_FINITE]},
        ),
        Target(
            name="LatentSimilarity",
            call=replay.LatentSimilarity,
            given=lambda: {"encoder": torch.nn.Identity(), "similarity": replay.cosine},
            bad={"encoder": [None, 3, "vae"], "similarity": [None, 3, "cosine"]},
            only=["encoder", "similarity"],
        ),
        Target(
            name="KeepTransition",
            call=lambda extra: replay.KeepTransition(extra),
            given=lambda: {"extra": "window"},
            bad={"extra": KEYS},
            also={"extra": ["key", "keys"]},
        ),
    ]


def _use() -> list[Target]:
    sampler = replay.AttentiveSampler(2.0)
    good = transitions()
    return [
        Target(
            name="AttentiveSampler.set_query",
            call=sampler.set_query,
            given=lambda: {"query": torch.rand(2, 6)},
            bad={"query": [torch.rand(0, 6), torch.rand(2, 2, 2), torch.full((2, 6), math.nan), 3]},
            only=["query"],
        ),
        Target(
            name="AttentiveSampler.load_state_dict",
            call=lambda **state: replay.AttentiveSampler(2).load_state_dict(state),
            given=lambda: dict(sampler.state_dict()),
            bad={
                "k": [0.5, math.nan],
                "num_samples": [-1, "a"],
                "query": [3, "text"],
                "newest": ["text", 3.5],
            },
            only=["query", "newest"],
        ),
        Target(
            name="ReplayBuffer.sample(NaN observation)",
            call=_sample,
            given=lambda: {"observation": torch.rand(16, 6)},
            bad={"observation": [torch.full((16, 6), math.nan)]},
            only=["observation"],
        ),
        Target(
            name="ReplayBuffer.sample(too few)",
            call=lambda batch_size: filled().sample(batch_size),
            given=lambda: {"batch_size": 4},
            bad={"batch_size": [0, -1, 50, 1000]},
            may_be_none=["batch_size"],
        ),
        Target(
            name="extend_rollout",
            call=replay.extend_rollout,
            given=lambda: {"buffer": filled(), "transitions": good.clone(), "num_envs": 2},
            bad={
                "buffer": [None, 3, []],
                "transitions": [good[:3], good.reshape(4, 4), None, {}, torch.rand(4)],
                "num_envs": [*BELOW_1, 3, 5],
            },
            only=["buffer", "transitions"],
        ),
        Target(
            name="forget_open_steps",
            call=replay.forget_open_steps,
            given=lambda: {"buffer": filled()},
            bad={"buffer": [None, 3, []]},
            only=["buffer"],
        ),
        Target(
            name="update_priorities",
            call=_update_priorities,
            given=lambda: {"td_error": torch.rand(4)},
            bad={"td_error": [-torch.ones(4), torch.full((4,), math.nan)]},
            only=["td_error"],
            also={"td_error": ["priority"]},
        ),
        Target(
            name="CompactStorage.set",
            call=lambda data: replay.CompactStorage(16).set(range(4), data),
            given=lambda: {"data": transitions(4)},
            bad={
                "data": [
                    transitions(4).exclude("observation"),
                    transitions(4).exclude(("next", "observation")),
                    None,
                    3,
                ]
            },
            only=["data"],
            also={"data": ["key", "observation"]},
        ),
        Target(
            name="KeepTransition.__call__",
            call=lambda data: replay.KeepTransition()(data),
            given=lambda: {"data": transitions(4)},
            bad={"data": [transitions(4).exclude("action"), transitions(4).exclude("next"), None]},
            only=["data"],
            also={"data": ["key", "action", "observation"]},
        ),
    ]
