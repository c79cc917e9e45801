"""Policies, learners and controllers. Nothing here needs a simulator."""

from modpush.agents.scripted import ScriptedPusher, ScriptedPusherConfig

__all__ = ["ScriptedPusher", "ScriptedPusherConfig"]
