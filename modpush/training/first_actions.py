"""The scripted pusher in an agent's environment, for the first transitions of a run."""

import torch
from tensordict import TensorDictBase

from modpush.agents.scripted import ScriptedPusher
from modpush.mdp.action_frame import ActionFrame
from modpush.recipes.config import PushEnvConfig
from modpush.recipes.sensing import observed_keys

__all__ = ["FirstActions"]

_NOISE = 0.2
"""Standard deviation of the noise, in units of half the action's range."""


class FirstActions:
    """`ScriptedPusher` along the planner's sub-goals, with noise, in the agent's axes."""

    def __init__(self, config: PushEnvConfig) -> None:
        self._pusher = ScriptedPusher(target_key="subgoal")
        frame = config.frame if config.action_frame is None else config.action_frame
        pose_key = observed_keys(config.sensing)["object_pose"]
        self._frame = ActionFrame(frame, object_pose_key=pose_key)

    def __call__(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Write the action, `[B, 3]` in [-1, 1]."""
        tensordict = self._frame.to_agent(self._pusher(tensordict))
        action = tensordict["action"]
        noisy = action + _NOISE * torch.randn_like(action)
        return tensordict.set("action", noisy.clamp(-1.0, 1.0))
