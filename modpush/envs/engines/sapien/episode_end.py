"""How episodes of `ClutterPush-v1` are truncated under `gymnasium.make`."""

from typing import Any

from mani_skill.utils.registration import TimeLimitWrapper

__all__ = ["EpisodeEnd"]


class EpisodeEnd(TimeLimitWrapper):
    """ManiSkill's time limit, and truncation when the object leaves the workspace."""

    def step(self, action: Any) -> Any:
        """As `gymnasium.Env.step`, batched."""
        observation, reward, terminated, truncated, info = super().step(action)
        return observation, reward, terminated, truncated | info["out_of_bounds"], info
