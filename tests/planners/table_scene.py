"""A tiny world to test transforms in: a disc pushed about among boxes, seen by an ideal camera."""

import numpy as np
import torch
from box_images import BAR, render, square
from tensordict import TensorDict, TensorDictBase
from torch import Tensor
from torchrl.data import Binary, Bounded, Composite, Unbounded
from torchrl.envs import EnvBase

from modpush.geometry import Camera, Label


class TableEnv(EnvBase):
    """The object moves as the action says, 2 cm a step at most; boxes stand still.

    Each scene's bar lies a little further than the one before, so that scenes cannot be mistaken.
    """

    def __init__(self, num_envs: int | None = None, side: int = 64) -> None:
        batch = () if num_envs is None else (num_envs,)
        super().__init__(batch_size=torch.Size(batch))
        self.camera = Camera(height=side, width=side)
        self.count = num_envs or 1
        self.bars = [(BAR[0] + 0.02 * b, BAR[1] + 0.02 * b, *BAR[2:]) for b in range(self.count)]
        self.observation_spec = Composite(
            depth=Unbounded(shape=(*batch, 1, side, side), dtype=torch.float32),
            segmentation=Bounded(0, 255, shape=(*batch, 1, side, side), dtype=torch.uint8),
            object_pose=Unbounded(shape=(*batch, 3), dtype=torch.float32),
            goal_position=Unbounded(shape=(*batch, 2), dtype=torch.float32),
            shape=batch,
        )
        self.action_spec = Bounded(-1, 1, shape=(*batch, 2), dtype=torch.float32)
        self.reward_spec = Unbounded(shape=(*batch, 1), dtype=torch.float32)
        done = Binary(shape=(*batch, 1), dtype=torch.bool)
        self.done_spec = Composite(
            done=done, terminated=done.clone(), truncated=done.clone(), shape=batch
        )
        self.pose = torch.zeros(self.count, 3)
        self.goal = torch.zeros(self.count, 2)
        self.episodes = torch.zeros(self.count, dtype=torch.int64)

    def _observe(self) -> dict[str, Tensor]:
        images = [
            render([(bar, Label.OBSTACLE), (square(*pose[:2].tolist()), Label.OBJECT)], self.camera)
            for bar, pose in zip(self.bars, self.pose, strict=True)
        ]
        side = self.camera.height
        observed = {
            "depth": torch.from_numpy(np.stack([depth for depth, _ in images])),
            "segmentation": torch.from_numpy(np.stack([segments for _, segments in images])),
            "object_pose": self.pose.clone(),
            "goal_position": self.goal.clone(),
        }
        for key in ("depth", "segmentation"):
            observed[key] = observed[key].reshape(self.count, 1, side, side)
        return {
            key: value.reshape(*self.batch_size, *value.shape[1:])
            for key, value in observed.items()
        }

    def _reset(self, tensordict: TensorDictBase | None = None, **kwargs: object) -> TensorDictBase:
        mask = torch.ones(self.count, dtype=torch.bool)
        if tensordict is not None and tensordict.get("_reset", None) is not None:
            mask = tensordict["_reset"].reshape(self.count)
        for b in mask.nonzero().flatten().tolist():
            # Another start each episode, so that what is left over from the last one shows.
            self.pose[b] = torch.tensor([0.32, 0.02 * (int(self.episodes[b]) % 5), 0.0])
            self.goal[b] = torch.tensor([0.70, 0.0])
            self.episodes[b] += 1
        return TensorDict(self._observe(), batch_size=self.batch_size)

    def _step(self, tensordict: TensorDictBase) -> TensorDictBase:
        self.pose[:, :2] += 0.02 * tensordict["action"].reshape(self.count, 2)
        far = self.pose[:, 1].abs() > 0.2
        done = far.reshape(*self.batch_size, 1)
        return TensorDict(
            {
                **self._observe(),
                "reward": torch.zeros(*self.batch_size, 1),
                "done": done,
                "terminated": done.clone(),
                "truncated": torch.zeros_like(done),
            },
            batch_size=self.batch_size,
        )

    def _set_seed(self, seed: int | None) -> None:
        torch.manual_seed(seed or 0)
