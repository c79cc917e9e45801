"""Policies: the corridor controller."""

from .krivic import CorridorConfig, PushingCorridorController, faithful_config

__all__ = ["CorridorConfig", "PushingCorridorController", "faithful_config"]
