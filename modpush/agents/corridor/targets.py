"""Choosing the point that the object is pushed towards, for a batch of scenes."""

import torch
from tensordict import TensorDict
from torch import Tensor

from modpush.agents.corridor.config import CorridorConfig
from modpush.agents.corridor.look_ahead import Limits, View, look_ahead
from modpush.agents.corridor.rules import Rules
from modpush.agents.corridor.scene import CorridorScene
from modpush.agents.corridor.turn_target import RoomNeeded, turn_target

CHECKED_AHEAD = 0.05
"""Distance ahead of the object that must be free when its target is turned [m]."""


def choose_targets(
    scene: CorridorScene, state: TensorDict, config: CorridorConfig, rules: Rules
) -> Tensor:
    """Look ahead on each scene's path, and turn the target where the tool has no room.

    Returns:
        `[B, 2]` (x, y) [m].
    """
    camera, cell = scene.camera, scene.camera.cell_size
    path, position, tool, previous = (
        camera.project(value.double()).numpy()
        for value in (state["path"], scene.object_position, scene.tool_position, state["target"])
    )
    first = (~state["started"].squeeze(-1)).tolist()
    targets = []
    touch = torch.minimum(config.touch_zone * scene.object_radius, scene.touch_radius) / cell
    for b, radius in enumerate((scene.object_radius / cell).tolist()):
        limits = Limits(
            outer=config.outer_zone * radius,
            inner=config.inner_zone * radius,
            touch=float(touch[b]),
            tool=config.tool_clearance / cell,
            behind=config.behind_distance / cell,
            relative=rules.relative_zones,
            path_step=config.path_step,
        )
        distance = scene.obstacle_distance[b]
        view = View(distance, path[b], position[b], tool[b], previous[b], first[b])
        targets.append(look_ahead(view, limits))
    target = camera.unproject(torch.tensor(targets, dtype=torch.float64))
    target = target.to(scene.object_position.dtype)
    return target if config.contact_distance == 0 else _make_room(scene, target, config)


def _make_room(scene: CorridorScene, target: Tensor, config: CorridorConfig) -> Tensor:
    """Targets `[B, 2]` [m] turned by `turn_target`."""
    camera, cell = scene.camera, scene.camera.cell_size
    positions = camera.project(scene.object_position.double()).numpy()
    targets = camera.project(target.double()).numpy()
    turned = []
    touch = torch.minimum(scene.object_radius, scene.touch_radius) / cell
    for b, radius in enumerate(scene.object_radius.tolist()):
        room = RoomNeeded(
            behind=(radius + config.contact_distance) / cell,
            tool=config.tool_clearance / cell,
            ahead=CHECKED_AHEAD / cell,
            touch=float(touch[b]),
        )
        turned.append(turn_target(scene.obstacle_distance[b], positions[b], targets[b], room))
    return camera.unproject(torch.tensor(turned, dtype=torch.float64)).to(target.dtype)
