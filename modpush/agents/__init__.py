"""Policies: the corridor controller."""

from .corridor_config import CorridorConfig, faithful_config
from .krivic import PushingCorridorController

__all__ = ["CorridorConfig", "PushingCorridorController", "faithful_config"]
