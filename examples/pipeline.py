"""The paper's system in a plain TorchRL pipeline, put together by hand from its parts.

    python examples/pipeline.py                   # free space, ends after 15 minutes
    python examples/pipeline.py --minutes 5

Environment, transforms, networks, loss and sampler are ours; collector, replay buffer, target networks
and optimizer are TorchRL's and PyTorch's. SWAP 1 to 3 mark the lines to change for another observation,
replay strategy and planner. Each line that is printed has the success rate since the last
one, with exploration noise: 1.00 while a scripted pusher acts (the first 5,000 steps), and from 0.05
to 0.99 after 20,500 steps for the agent. 46,000 steps took four minutes of CPU time.
"""

import argparse
import time
import warnings
from typing import Final

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictSequential
from torchrl.collectors import Collector
from torchrl.data import LazyTensorStorage, TensorDictReplayBuffer
from torchrl.envs import Compose, ExcludeTransform, TransformedEnv
from torchrl.modules import AdditiveGaussianModule
from torchrl.objectives import SoftUpdate

from modpush.agents import ScriptedPusher, TQCLoss, make_actor, make_critic
from modpush.encoders import DepthVAE, EgocentricWindow, Encode
from modpush.envs import PushEnv
from modpush.mdp import ActionFrame, PushObservation, PushReward, RewardConfig, latent_entry
from modpush.planners import OccupancyGrid, PlannerSubgoals
from modpush.replay import AttentiveSampler, KeepTransition, NStepTransform

FRAME: Final = "path"  # x points from the object to the sub-goal: one behaviour for all directions
ROLLOUT, BATCH_SIZE, HIDDEN_SIZES, GAMMA = 8, 256, (256, 256), 0.98


def make_env(num_envs: int) -> TransformedEnv:
    """Scenes with planner, encoder, observation and reward."""
    # Free space is learned in minutes, the paper's `modpush.envs.OBSTACLE_SCENES` in about an hour.
    env = PushEnv(num_envs, scene="free", seed=0)
    encoder = DepthVAE.from_pretrained()
    latent = ("latent", latent_entry(encoder))  # relative to that of an empty window
    # SWAP 1, the observation: other names of `modpush.mdp.ENTRIES`, or functions of your own.
    names = ["ee_position", "ee_axis", "object_axis", "subgoal_past", "contact", "path_length"]
    transforms = [
        OccupancyGrid(),
        # SWAP 3, the planner: another name of `modpush.planners.PLANNERS`, or a planner of your own.
        PlannerSubgoals("distance_field", mode="lookahead"),
        EgocentricWindow(FRAME),
        Encode(encoder),
        ActionFrame(FRAME),  # before the transforms that read the agent's action
        PushObservation(FRAME, entries=[latent, *names]),
        PushReward(RewardConfig(scale=0.1, normalisation="constant")),
        ExcludeTransform("depth", "segmentation", "occupancy", "window"),
    ]
    return TransformedEnv(env, Compose(*transforms))


def main(
    steps: int = 192_000, minutes: float = 15.0, num_envs: int = 16, learning_starts: int = 5000
) -> float:
    """Train, and return the success rate that was printed last."""
    torch.manual_seed(0)
    env = make_env(num_envs)
    width, action_spec = env.observation_spec["observation"].shape[-1], env.action_spec_unbatched
    actor = make_actor(width, action_spec, HIDDEN_SIZES)
    critics = [make_critic(width, 3, 25, HIDDEN_SIZES) for _ in range(2)]  # of 25 quantiles
    loss = TQCLoss(actor, critics, num_qvalue_nets=2, action_spec=action_spec, alpha_init=0.02)
    loss.make_value_estimator(gamma=GAMMA)
    target_updater = SoftUpdate(loss, tau=0.005)
    optimizer = torch.optim.Adam(loss.parameters(), lr=3e-4)

    # SWAP 2, the replay strategy: any other sampler, such as TorchRL's `RandomSampler()`.
    sampler = AttentiveSampler(k=4, num_queries=num_envs)
    storage = LazyTensorStorage(steps)
    buffer = TensorDictReplayBuffer(storage=storage, sampler=sampler, batch_size=BATCH_SIZE)
    buffer.append_transform(NStepTransform(3, GAMMA))  # returns of three steps

    noise = AdditiveGaussianModule(action_spec, sigma_init=0.4, sigma_end=0.4)
    explore = TensorDictSequential(actor, noise)
    pusher, frame = ScriptedPusher(target_key="subgoal"), ActionFrame(FRAME)

    def policy(td: TensorDictBase) -> TensorDictBase:
        if len(buffer) >= learning_starts:
            return explore(td)
        return noise(frame.to_agent(pusher(td)))  # shows what reaching the goal is worth

    keep = KeepTransition(("next", "success"))
    frames = num_envs * ROLLOUT
    collector = Collector(env, policy, frames_per_batch=frames, total_frames=steps, postproc=keep)
    start, rate, results = time.monotonic(), 0.0, []
    for number, data in enumerate(collector, 1):  # [num_envs, ROLLOUT]
        buffer.extend(data.exclude(("next", "success")))
        for _ in range(frames // 8 if len(buffer) >= learning_starts else 0):
            losses = loss(buffer.sample())
            (losses["loss_actor"] + losses["loss_qvalue"] + losses["loss_alpha"]).backward()
            optimizer.step()
            optimizer.zero_grad()
            target_updater.step()
        passed = (time.monotonic() - start) / 60
        results += data["next", "success"][data["next", "done"]].tolist()
        if number % 20 == 0:
            rate = sum(results) / max(1, len(results))
            print(f"{number * frames:7d} steps {passed:5.1f} min  success {rate:.2f}", flush=True)
            results.clear()
        if passed > minutes:
            break
    collector.shutdown()
    return rate


if __name__ == "__main__":
    warnings.filterwarnings("ignore", message="Failed to find system libvulkan")
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--steps", type=int, default=192_000, help="environment steps")
    parser.add_argument("--minutes", type=float, default=15.0, help="minutes after which it ends")
    main(**vars(parser.parse_args()))
