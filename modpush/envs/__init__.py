"""The pushing task: `PushEnv` for TorchRL, and the same task for ManiSkill and for plain Gymnasium.

Importing this package registers `ClutterPush-v1` (ManiSkill) and `modpush/Push-v0` (plain Gymnasium)
with Gymnasium, and loads no simulator.

Names are imported on first use; `__init__.pyi` lists them.
"""

import gymnasium
import lazy_loader
from gymnasium.envs.registration import WrapperSpec, registry

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

if "modpush/Push-v0" not in registry:
    gymnasium.register(
        "modpush/Push-v0",
        # A name, which Gymnasium imports when the environment is made: this package knows no recipe.
        entry_point="modpush.recipes.gym_env:PushGymEnv",
        # Gymnasium's TimeLimit alone ends episodes, after as many steps as `gymnasium.make` is told.
        max_episode_steps=200,
        kwargs={"max_episode_steps": None},
    )
if "ClutterPush-v1" not in registry:
    gymnasium.register(
        "ClutterPush-v1",
        entry_point="modpush.envs.engines.sapien.maniskill_task:ClutterPushEnv",
        max_episode_steps=200,
        disable_env_checker=True,
        additional_wrappers=(
            WrapperSpec(
                "EpisodeEnd",
                "modpush.envs.engines.sapien.maniskill_task:EpisodeEnd",
                {"max_episode_steps": 200},
            ),
        ),
    )
