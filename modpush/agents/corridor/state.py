"""What the corridor controller carries from step to step."""

from typing import Any

import torch
from torchrl.data import Binary, Composite, Unbounded

from modpush.agents.corridor.config import CorridorConfig


def state_spec(config: CorridorConfig, batch: tuple[int, ...]) -> Composite:
    """Spec of the state of a batch of scenes; a scene whose episode has not begun is all zero.

    Keys, each `[*batch, ...]` float32 unless said: `started` (1) bool; `path` (path_points, 2) and
    `goal` (2) of the episode [m]; of the last step `target` (2), `object_position` (2),
    `tool_position` (2) [m], `alpha` (1) and the object's deviation `gamma` (1) [rad]; `alphas`
    (max_angles) of pushes that went well, `alpha_count` (1) of them; `gamma_sum` (2) and `gamma_count`
    (1) over the steps in which the object moved; `still` (1), steps in which nothing moved, and
    `escape` (1), steps left to back off.
    """
    shapes = {
        "path": (config.path_points, 2),
        "goal": (2,),
        "target": (2,),
        "object_position": (2,),
        "tool_position": (2,),
        "alpha": (1,),
        "gamma": (1,),
        "alphas": (config.max_angles,),
        "alpha_count": (1,),
        "gamma_sum": (2,),
        "gamma_count": (1,),
        "still": (1,),
        "escape": (1,),
    }
    leaves: dict[str, Any] = {
        key: Unbounded(shape=(*batch, *shape), dtype=torch.float32) for key, shape in shapes.items()
    }
    leaves["started"] = Binary(shape=(*batch, 1), dtype=torch.bool)
    return Composite(leaves, shape=batch)
