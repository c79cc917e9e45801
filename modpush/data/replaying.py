"""`replay_demonstration`: does an episode's commands again."""

import torch
from tensordict import TensorDict

from modpush._arguments import checked_arguments
from modpush._checks import check_instance
from modpush.data.demonstration import Demonstration, body_state
from modpush.envs.push_env import PushEnv

__all__ = ["replay_demonstration"]


@checked_arguments
def replay_demonstration(demonstration: Demonstration, env: PushEnv) -> TensorDict:
    """Start where a demonstration started, and carry out its commands.

    On a CPU all states are equal to the recorded ones to the last bit, in an environment with the
    options of the recorded one.

    Args:
        demonstration: The episode, of T steps.
        env: A `PushEnv` of one scene.

    Returns:
        What the environment emitted at reset and after each step, batch size `[T + 1]`, and
        `physics`, see `body_state`, beside it.

    Raises:
        TypeError: If the environment is not a `PushEnv`.
        ValueError: If the environment has several scenes.
    """
    check_instance("replay_demonstration", "env", env, PushEnv)
    if env.batch_size != torch.Size([1]):
        raise ValueError(f"replay_demonstration: env must have one scene, got {env.batch_size[0]}.")
    keys = [*env.observation_spec.keys(True, True), *env.done_spec.keys(True, True)]

    def noted(td: TensorDict) -> TensorDict:
        state = torch.from_numpy(body_state(env.get_state().scenes[0]))
        return td.select(*keys).clone()[0].set("physics", state)

    td = env.reset(scenarios=[demonstration.scenario])
    seen = [noted(td)]
    for command in torch.from_numpy(demonstration.command):
        td = env.step(td.set("action", command[None]))["next"]
        seen.append(noted(td))
    return torch.stack(seen)
