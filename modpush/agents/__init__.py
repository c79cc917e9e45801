"""Policies, learners and controllers. Nothing here needs a simulator."""

from modpush.agents.corridor_config import CorridorConfig, faithful_config
from modpush.agents.krivic import PushingCorridorController
from modpush.agents.networks import make_actor, make_critic
from modpush.agents.quantiles import quantile_huber, truncate_atoms
from modpush.agents.scripted import ScriptedPusher, ScriptedPusherConfig
from modpush.agents.tqc import TQCAgent, TQCConfig, make_tqc
from modpush.agents.tqc_loss import TQCLoss
from modpush.agents.update import TQCUpdate

__all__ = [
    "CorridorConfig",
    "PushingCorridorController",
    "ScriptedPusher",
    "ScriptedPusherConfig",
    "TQCAgent",
    "TQCConfig",
    "TQCLoss",
    "TQCUpdate",
    "faithful_config",
    "make_actor",
    "make_critic",
    "make_tqc",
    "quantile_huber",
    "truncate_atoms",
]
