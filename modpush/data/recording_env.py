"""`RecordingEnv`: a `PushEnv` for policies, which records its episodes as another stack sees them."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from tensordict import TensorDict, TensorDictBase
from torch import Tensor
from torchrl.envs import EnvBase, Transform, TransformedEnv
from torchrl.envs.utils import step_mdp

from modpush._validation import checked_arguments
from modpush.data.minari_dataset import RecordedEpisode
from modpush.envs.push_env import PushEnv
from modpush.envs.scenes.objects import PushedObject
from modpush.geometry.frames import frame_yaw
from modpush.mdp.action_frame import ActionFrame, turn_action

_POSES = ("object_pose", "goal_position", "ee_pose")
_FLAGS = (
    "success",
    "out_of_bounds",
    "object_contact",
    "obstacle_contact",
    "tool_obstacle_contact",
)
_IMAGES = ("depth", "segmentation")


class _NoteCommand(Transform):
    """Keeps the action that reaches `PushEnv`, in the base frame."""

    def __init__(self) -> None:
        super().__init__(in_keys_inv=["action"], out_keys_inv=["action"])
        self.command = torch.zeros(0)

    def _inv_call(self, tensordict: TensorDictBase) -> TensorDictBase:
        self.command = tensordict["action"].clone()
        return tensordict


class RecordingEnv(EnvBase):
    """Has the interface of `PushEnv`, and records the output of the stack of transforms on it.

    A policy may have its own transforms on top of this environment: its observation and action need
    not be the recorded ones. Its action, in the base frame, is turned into the axes of the recorded
    stack, shrunk where it leaves the box of actions there (the direction is kept), and taken by that
    stack; the action that was carried out is recorded.

    Args:
        env: Result of `make_push_env` with `keep_images=True`. It is closed with this environment.
        images: Record depth and segmentation.

    Raises:
        ValueError: If the environment has no `PushEnv` at its bottom or does not emit images.
    """

    batch_locked = True

    @checked_arguments
    def __init__(self, env: TransformedEnv, images: bool = False) -> None:
        base = env.base_env
        if not isinstance(base, PushEnv):
            raise ValueError(
                f"RecordingEnv: env must be a stack of transforms on a PushEnv, got {env!r}."
            )
        missing = set(base.observation_spec.keys()) - set(env.observation_spec.keys())
        if missing:
            raise ValueError(
                f"RecordingEnv: env must emit {sorted(missing)}, which policies may need; make it with "
                "keep_images=True."
            )
        super().__init__(device=base.device, batch_size=base.batch_size)
        self.is_closed = False
        self._env, self._base, self._images = env, base, images
        self._note = _NoteCommand()
        env.insert_transform(0, self._note)
        turns = [t for t in env.transform if isinstance(t, ActionFrame)]
        self._turn = turns[0] if turns else None
        for name in ("observation_spec", "action_spec", "reward_spec", "done_spec"):
            setattr(self, name, getattr(base, name).clone())
        self._keys = [*base.observation_spec.keys(True, True), *base.done_spec.keys(True, True)]
        self._state = TensorDict({}, batch_size=self.batch_size)
        self._records: list[dict[str, list[Any]]] = [{} for _ in range(self.batch_size[0])]

    @property
    def pushed_objects(self) -> Mapping[str, PushedObject]:
        """The objects that may be pushed, by name."""
        return self._base.pushed_objects

    def _set_seed(self, seed: int | None) -> None:
        self._env.set_seed(seed)

    def _reset(self, tensordict: TensorDictBase | None = None, **options: Any) -> TensorDictBase:
        """Start new episodes, with the arguments of `PushEnv`'s reset."""
        mask = None if tensordict is None else tensordict.get("_reset", None)
        if mask is None:
            self._state = self._env.reset(**options)
            rows = range(self.batch_size[0])
        else:
            self._state = self._env.reset(self._state.set("_reset", mask), **options)
            self._state.pop("_reset", None)
            rows = mask.reshape(self.batch_size[0], -1).any(-1).nonzero()[:, 0].tolist()
        for row in rows:
            self._records[row] = {}
        self._record_state(self._state, rows)
        return self._emitted(self._state)

    def _step(self, tensordict: TensorDictBase) -> TensorDictBase:
        action = self._turned(tensordict["action"])
        stepped = self._env.step(self._state.set("action", action))
        after = stepped["next"]
        rows = range(self.batch_size[0])
        done = {
            "action": action.numpy(),
            "command": self._note.command.numpy(),
            "reward": after["reward"][:, 0].numpy(),
            "terminated": after["terminated"][:, 0].numpy(),
            "truncated": after["truncated"][:, 0].numpy(),
        }
        for row in rows:
            for key, value in done.items():
                self._records[row].setdefault(key, []).append(value[row])
        self._record_state(after, rows)
        self._state = step_mdp(stepped)
        return self._emitted(after).set("reward", after["success"].float())

    def _turned(self, command: Tensor) -> Tensor:
        """An action in the base frame in the axes of the recorded stack, `[B, 3]`."""
        if self._turn is None or self._turn.frame == "base":
            return command.clone()
        pose, subgoal = self._state[self._turn.object_pose_key], self._state.get("subgoal", None)
        return turn_action(command, -frame_yaw(self._turn.frame, pose, subgoal))

    def _emitted(self, td: TensorDictBase) -> TensorDictBase:
        """The entries of `PushEnv` among the stack's."""
        return TensorDict({key: td[key] for key in self._keys}, batch_size=self.batch_size)

    def _record_state(self, td: TensorDictBase, rows: Any) -> None:
        values: dict[str, NDArray[Any]] = {key: td[key].numpy() for key in ("observation", *_POSES)}
        values |= {key: td[key][:, 0].numpy() for key in _FLAGS}
        if self._images:
            values |= {key: td[key][:, 0].numpy() for key in _IMAGES}
        for row in rows:
            for key, value in values.items():
                self._records[row].setdefault(key, []).append(value[row].copy())

    def episode(self, row: int, *, policy: str, number: int, seed: int) -> RecordedEpisode:
        """The episode of a scene since its last reset.

        Args:
            row: The scene.
            policy: Name of the policy that acted.
            number: Number of the start.
            seed: Seed of the start.
        """
        found = {key: np.array(value) for key, value in self._records[row].items()}
        infos = (*_POSES, *_FLAGS, "command")
        return RecordedEpisode(
            policy=policy,
            number=number,
            seed=seed,
            scenario=self._base.scenarios[row],
            infos={key: found.pop(key) for key in infos},
            images={key: found.pop(key) for key in _IMAGES if key in found},
            **found,
        )

    def close(self, *, raise_if_closed: bool = True) -> None:
        """Free the simulators."""
        if not self.is_closed:
            self._env.close()
        super().close(raise_if_closed=raise_if_closed)
