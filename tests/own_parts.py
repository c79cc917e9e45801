"""Parts of one's own, at the top level of a module: they can be named, pickled and imported."""

import torch
from torch import Tensor, nn
from torchrl.data import RandomSampler
from torchrl.data.replay_buffers.samplers import Sampler
from torchrl.envs import RewardScaling
from torchrl.objectives import SACLoss

from modpush.envs.scenes.obstacle import Obstacle
from modpush.mdp.observation_inputs import ObservationInputs
from modpush.mdp.step_outcome import StepOutcome
from modpush.recipes import make_push_env
from modpush.replay import ReplayConfig


class MeanHeight(nn.Module):
    """Encodes the mean height of the window's quarters."""

    latent_dim = 4
    window_size = 32

    def __init__(self, gain: float = 1.0) -> None:
        super().__init__()
        self.register_buffer("gain", torch.tensor(gain))

    def forward(self, window: Tensor) -> Tensor:
        return self.gain * nn.functional.adaptive_avg_pool2d(window, 2).flatten(1)


def one_post(rng, difficulty: float) -> list[Obstacle]:
    """One cube in the middle of the workspace."""
    return [Obstacle((0.05, 0.05, 0.05), (0.475, 0.0, 0.0))]


def goal_direction(inputs: ObservationInputs) -> Tensor:
    """Unit vector from the object to the goal."""
    return nn.functional.normalize(inputs.goal, dim=-1)


def small_actions(outcome: StepOutcome) -> Tensor:
    """Penalty for large actions."""
    return -outcome["action"].square().sum(-1, keepdim=True)


def make_scaled_env(config, **options):
    """The paper's environment with a transform of TorchRL's on top."""
    return make_push_env(config, **options).append_transform(RewardScaling(loc=0.0, scale=0.5))


class SmallConv(nn.Module):
    """A convolutional encoder of 32 x 32 windows."""

    latent_dim = 6
    window_size = 32

    def __init__(self) -> None:
        super().__init__()
        with torch.random.fork_rng():
            torch.manual_seed(0)
            self.layers = nn.Sequential(
                nn.Conv2d(1, 4, 4, stride=4), nn.ReLU(), nn.Flatten(), nn.Linear(256, 6)
            )

    def forward(self, window: Tensor) -> Tensor:
        return self.layers(window)


def newest_half(config: ReplayConfig) -> Sampler:
    """A sampler of TorchRL's."""
    return RandomSampler()


def sac_loss(config, actor, critics, specs):
    """TorchRL's SAC loss with the same networks."""
    loss = SACLoss(
        actor,
        critics,
        num_qvalue_nets=len(critics),
        alpha_init=config.alpha_init,
        action_spec=specs.action,
    )
    loss.make_value_estimator(gamma=config.gamma)
    return loss
