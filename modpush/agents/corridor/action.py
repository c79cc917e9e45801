"""One decision of the corridor controller."""

import torch
from tensordict import TensorDict
from torch import Tensor

from modpush.agents.corridor.config import CorridorConfig
from modpush.agents.corridor.push_learning import correction, judge_stance, learn
from modpush.agents.corridor.push_motion import (
    follow_tool_path,
    keep_off_obstacles,
    push_velocity,
    turn_wide_side,
)
from modpush.agents.corridor.rules import RULES
from modpush.agents.corridor.scene import CorridorScene, direction_of
from modpush.agents.corridor.targets import choose_targets
from modpush.planners import Planner


def choose_action(
    scene: CorridorScene, state: TensorDict, config: CorridorConfig, planner: Planner
) -> Tensor:
    """Learn from the last step, then choose a target and move towards it.

    The state holds a planned path of the object, and is updated in place; `planner` plans the tool's
    path around the object.

    Returns:
        `[B, 3]` float32 in [-1, 1]: (dx, dy, dyaw).
    """
    rules = RULES[config.rules]
    position, tool = scene.object_position, scene.tool_position
    learn(state, position, config, rules)
    target = choose_targets(scene, state, config, rules)
    push_heading = direction_of(target - position)
    alpha = rules.wrap_angle(direction_of(position - tool) - push_heading)
    stance = judge_stance(state, alpha, config, rules)
    has_moved = state["gamma_count"].squeeze(-1) > 0
    velocity = push_velocity(scene, stance, has_moved, config, rules)
    velocity = follow_tool_path(scene, velocity, target, stance.relocate, config, planner)
    velocity = keep_off_obstacles(scene, velocity, stance.relocate, state, config)
    heading = direction_of(velocity) - correction(state, config, rules)
    state["object_position"] = position
    state["tool_position"] = tool
    state["target"] = target
    state["alpha"] = alpha[:, None]
    state["started"] = torch.ones_like(state["started"])
    action = torch.stack([heading.cos(), heading.sin(), torch.zeros_like(heading)], -1)
    action = action * config.action_length
    if config.max_turn > 0:
        action[:, 2] = turn_wide_side(push_heading, scene.tool_yaw, config.max_turn)
    return action
