"""Quantiles, similarities, statistics and metrics, with right arguments."""

import math

import numpy as np
import torch

from modpush import encoders
from modpush.agents import encode_images, quantile_huber, truncate_atoms
from modpush.evaluation import (
    bootstrap_interval,
    episode_metrics,
    paired_t_test,
)
from modpush.replay import cosine, negative_l2
from tests.malformed.target import BELOW_1, NOT_FINITE, NOT_POSITIVE, Target


def targets() -> list[Target]:
    """All of them."""
    return [*_numbers()]


def _numbers() -> list[Target]:
    flags = np.array([True, False])
    metrics = {
        "object_position": np.zeros((3, 2)),
        "goal_position": np.ones(2),
        "reward": np.zeros(2),
        "object_contact": flags,
        "object_contact_at_end": flags,
        "obstacle_contact": flags,
        "tool_obstacle_contact": flags,
        "obstacle_contact_at_end": flags,
        "tool_obstacle_contact_at_end": flags,
        "ee_position": np.zeros((3, 2)),
        "control_freq": 15.0,
        "success": True,
        "out_of_bounds": False,
        "shortest_length": 1.0,
    }
    pair = {"candidates": torch.rand(2, 5, 3), "queries": torch.rand(2, 3)}
    return [
        Target(
            name="truncate_atoms",
            call=truncate_atoms,
            given=lambda: {"atoms": torch.rand(2, 4, 5), "num_dropped": 2},
            bad={"num_dropped": [10, 100, -1], "atoms": [None, "text", torch.tensor(1.0)]},
            only=["atoms"],
        ),
        Target(
            name="quantile_huber",
            call=quantile_huber,
            given=lambda: {"quantiles": torch.rand(2, 4, 5), "targets": torch.rand(4, 6)},
            bad={
                "quantiles": [None, torch.rand(2, 3, 5), torch.rand(2, 4, 5).double(), "text"],
                "targets": [None, torch.rand(3, 6), torch.rand(4, 6).double(), torch.rand(6)],
            },
            only=["quantiles", "targets"],
        ),
        *(
            Target(
                name=function.__name__,
                call=function,
                given=lambda: {key: value.clone() for key, value in pair.items()},
                bad={
                    "candidates": [torch.rand(2, 5, 4), torch.rand(3), None, "text"],
                    "queries": [torch.rand(2, 4), torch.rand(3, 3), None, "text"],
                },
                only=["candidates", "queries"],
            )
            for function in (cosine, negative_l2)
        ),
        Target(
            name="encode_images",
            call=encode_images,
            given=lambda: {"encoder": encoders.RayScan(), "images": torch.rand(2, 1, 64, 64)},
            bad={"images": [torch.ones(2, 1, 64, 64, dtype=torch.int64), None, torch.rand(64)]},
            only=["images", "encoder"],
            also={"images": ["window"]},  # a shape that only the encoder knows
        ),
        Target(
            name="bootstrap_interval",
            call=bootstrap_interval,
            given=lambda: {
                "values": np.arange(5.0),
                "confidence": 0.9,
                "resamples": 20,
                "seed": 0,
            },
            bad={
                "values": ["text", np.ones((2, 2)), [1.0, math.nan], 3, None],
                "confidence": [0.0, 1.0, *NOT_FINITE],
                "resamples": BELOW_1,
                "seed": [-1],
            },
            only=["values"],
        ),
        Target(
            name="paired_t_test",
            call=paired_t_test,
            given=lambda: {"first": np.arange(5.0), "second": np.ones(5)},
            bad={
                "first": ["text", np.ones(4), np.ones((2, 2)), [1.0, math.nan, 1, 1, 1], None],
                "second": ["text", np.ones(4), np.ones((2, 2)), [1.0, math.nan, 1, 1, 1], None],
            },
            only=["first", "second"],
        ),
        Target(
            name="episode_metrics",
            call=episode_metrics,
            given=lambda: dict(metrics),
            bad={
                "object_position": [np.zeros((2, 2)), np.zeros((3, 3)), np.full((3, 2), math.nan)],
                "goal_position": [np.ones(3), np.full(2, math.nan), None],
                "reward": [np.zeros(3), np.full(2, math.nan)],
                "obstacle_contact": [flags[:1], None, "text", np.array([0.5, math.inf])],
                "object_contact": [flags[:1], None, "text"],
                "shortest_length": NOT_POSITIVE,
                "ee_position": [np.zeros((2, 2)), np.full((3, 2), math.nan), None],
                "control_freq": NOT_POSITIVE,
            },
            only=["object_position", "goal_position", "reward", "object_contact"],
        ),
    ]
