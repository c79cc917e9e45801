"""Policies, learners and controllers. Nothing here needs a simulator."""

from modpush.agents.krivic import CorridorConfig, PushingCorridorController, faithful_config
from modpush.agents.scripted import ScriptedPusher, ScriptedPusherConfig

__all__ = [
    "CorridorConfig",
    "PushingCorridorController",
    "ScriptedPusher",
    "ScriptedPusherConfig",
    "faithful_config",
]
