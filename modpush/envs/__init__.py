"""The task and its transforms. Names are imported on first use, so this alone costs no simulator.

Importing the package registers `ClutterPush-v1` (ManiSkill's ways) and `ClutterPushState-v1` (plain
Gymnasium's) with Gymnasium.
"""

from importlib import import_module
from typing import Any

import gymnasium
from gymnasium.envs.registration import WrapperSpec, registry

_HOME = {
    "CAMERA": "camera",
    "Curriculum": "curriculum",
    "CurriculumConfig": "curriculum",
    "CurriculumScenes": "curriculum",
    "ActionFrame": "frames",
    "PushObservation": "observation",
    "PushReward": "rewards",
    "RewardConfig": "rewards",
    "Camera": "camera",
    "ClutterPushEnv": "task",
    "Dynamics": "scenarios",
    "OBJECTS": "objects",
    "HARD_SCENES": "scenes",
    "OBSTACLE_SCENES": "scenes",
    "Obstacle": "scenes",
    "PushEnv": "push_env",
    "PushGymEnv": "gym_env",
    "PushedObject": "objects",
    "SCENES": "scenes",
    "Scenario": "scenarios",
    "ScenarioConfig": "scenarios",
    "find_render_device": "rendering",
    "sample_scenario": "scenarios",
}

__all__ = [
    *sorted(_HOME),
]


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_HOME[name]}"), name)


if "ClutterPushState-v1" not in registry:
    gymnasium.register("ClutterPushState-v1", entry_point="modpush.envs.gym_env:PushGymEnv")
if "ClutterPush-v1" not in registry:
    gymnasium.register(
        "ClutterPush-v1",
        entry_point="modpush.envs.task:ClutterPushEnv",
        max_episode_steps=200,
        disable_env_checker=True,
        additional_wrappers=(
            WrapperSpec("EpisodeEnd", "modpush.envs.task:EpisodeEnd", {"max_episode_steps": 200}),
        ),
    )
