"""A policy that a person drives."""

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase

__all__ = ["HandPolicy"]


class HandPolicy(TensorDictModuleBase):
    """Takes the action that was last pressed for some steps, then stands still.

    A browser repeats a key that is held about 30 times a second after a first pause of up to half a
    second; a press therefore lasts a few steps.
    """

    in_keys = ["object_pose"]  # noqa: RUF012
    out_keys = ["action"]  # noqa: RUF012

    def __init__(self) -> None:
        super().__init__()
        self._action = (0.0, 0.0, 0.0)
        self._steps_left = 0

    def press(self, action: tuple[float, float, float], steps: int = 5) -> None:
        """Take an action (dx, dy, dyaw) in [-1, 1], base frame, for this many steps."""
        self._action, self._steps_left = action, steps

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Write the action, `[B, 3]`."""
        pose = tensordict["object_pose"]
        values = self._action if self._steps_left > 0 else (0.0, 0.0, 0.0)
        self._steps_left -= 1
        tensordict["action"] = torch.tensor(values).expand(pose.shape[0], 3).clone()
        return tensordict
