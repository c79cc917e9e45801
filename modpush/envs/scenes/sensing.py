"""`SensingConfig`: how late and how exactly a policy sees the world, and how late it acts."""

import math
from typing import Literal

from modpush._checks import check_span
from modpush._types import NonNegative, NonNegativeLength, StepSpan
from modpush._validation import checked

SensingName = Literal["exact", "noise", "delay", "noise_delay"]


@checked
class SensingConfig:
    """Delays, and noise of the object's pose, between a policy and the world; none by default."""

    action_delay: StepSpan = (0, 0)
    """Lowest and highest age of the action that is executed [control steps], see `ActionDelay`."""
    observation_delay: StepSpan = (0, 0)
    """Lowest and highest age of poses, joint angles, contact flag and images that the policy's
    observation is computed from [control steps], see `ObservationDelay`."""
    position_noise: NonNegativeLength = 0.0
    """Largest error of x and of y of the object [m], uniform and independent in every step."""
    yaw_noise: NonNegative = 0.0
    """Largest error of the object's yaw [rad], uniform and independent in every step."""

    def __post_init__(self) -> None:
        """Check the order of the ranges."""
        for name in ("action_delay", "observation_delay"):
            check_span(f"SensingConfig: {name}", getattr(self, name))

    @property
    def noisy(self) -> bool:
        """True if the object's pose has noise."""
        return self.position_noise > 0 or self.yaw_noise > 0

    @property
    def exact(self) -> bool:
        """True if the policy observes the present, true state."""
        return not self.noisy and self.observation_delay == (0, 0)


SENSING: dict[SensingName, SensingConfig] = {
    "exact": SensingConfig(),
    "noise": SensingConfig(position_noise=0.015, yaw_noise=math.radians(7.5)),
    "delay": SensingConfig(action_delay=(1, 3), observation_delay=(1, 1)),
    "noise_delay": SensingConfig(
        position_noise=0.015,
        yaw_noise=math.radians(7.5),
        action_delay=(1, 3),
        observation_delay=(1, 1),
    ),
}
"""Conditions of evaluation by name. Noise and numbers of steps are those with which MuJoCo Playground
trains `PandaRobotiqPushCube` for hardware: actions 1 to 3 steps old, and observations 6 to 12 simulation
steps of 5 ms, 30 to 60 ms, for which one control step of 67 ms stands here. Its steps of actions are of
5 ms, too, so that a delay here is 13 times as long."""
