"""Policies, learners and controllers. Nothing here needs a simulator."""

from modpush.agents.corridor_config import CorridorConfig, faithful_config
from modpush.agents.krivic import PushingCorridorController
from modpush.agents.scripted import ScriptedPusher, ScriptedPusherConfig

__all__ = [
    "CorridorConfig",
    "PushingCorridorController",
    "ScriptedPusher",
    "ScriptedPusherConfig",
    "faithful_config",
]
