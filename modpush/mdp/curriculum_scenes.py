"""`CurriculumScenes`: an environment's episodes drawn from a curriculum."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Any

import torch
from tensordict import NestedKey, TensorDictBase
from torchrl.data import TensorSpec

from modpush._checks import read_key
from modpush._transforms import DescribedTransform, add_unbounded
from modpush._types import NonNegativeInteger
from modpush._validation import checked_arguments
from modpush.envs.scenes.scenario import ScenarioConfig
from modpush.mdp.curriculum import Curriculum


class CurriculumScenes(DescribedTransform):
    """Draws a `PushEnv`'s episodes from a curriculum, and tells the curriculum how they end.

    An episode that began before the present stage does not count for it, and no episode counts twice if
    its scene is reset later than it ends. The curriculum replaces scenes, difficulty and distance of the
    environment's `scenario`; the other fields are kept, also when a new `scenario` is set later. The
    environment's `yaw_tolerance` is replaced for all scenes at once. The curriculum's state is part of
    the environment's `state_dict`.

    Args:
        curriculum: Curriculum that is read at each reset and receives the result of each episode.
        evaluated_envs: Indices of the scenes whose episodes count towards the next stage, such as
            those that act without noise; all by default.
        success_key: Read, `[..., 1]` bool.
        done_key: Read, `[..., 1]` bool.
        level_key: Written, `[..., 1]` float32: number of stages passed.

    Raises:
        RuntimeError: At a reset, if the environment is not based on a `PushEnv`.
        ValueError: At a reset, if `evaluated_envs` names a scene that does not exist.
        KeyError: If a key is missing.
    """

    @checked_arguments
    def __init__(
        self,
        curriculum: Curriculum,
        *,
        evaluated_envs: Sequence[NonNegativeInteger] | None = None,
        success_key: NestedKey = "success",
        done_key: NestedKey = "done",
        level_key: NestedKey = "curriculum_level",
    ) -> None:
        super().__init__(in_keys=[success_key, done_key], out_keys=[level_key])
        self.curriculum = curriculum
        self.evaluated_envs = None if evaluated_envs is None else frozenset(evaluated_envs)
        self.success_key, self.done_key, self.level_key = success_key, done_key, level_key
        self._base = ScenarioConfig()
        self._drawn_from: ScenarioConfig | None = None
        self._began_at: dict[int, int | None] = {}

    def describe(self) -> dict[str, Any]:
        """Settings of the curriculum."""
        return {"curriculum": asdict(self.curriculum.config)}

    @property
    def _env(self) -> Any:
        env = getattr(self.parent, "base_env", None)
        if env is None or not hasattr(env, "scenario"):
            raise RuntimeError(
                "CurriculumScenes: put it directly onto a PushEnv (or what has its `scenario` and "
                f"`scenarios`), it sits on {type(env).__name__}."
            )
        return env

    def _reset_env_preprocess(self, tensordict: TensorDictBase | None) -> TensorDictBase | None:
        env = self._env
        count = env.batch_size[0]
        if outside := sorted(i for i in self.evaluated_envs or () if i >= count):
            raise ValueError(
                f"CurriculumScenes: evaluated_envs must be indices of the {count} scenes, got {outside}."
            )
        if env.scenario is not self._drawn_from:  # the environment's first one, or set since then
            self._base = env.scenario
        env.scenario = self._drawn_from = self.curriculum.scenario(self._base)
        if self.curriculum.yaw_tolerance is not None:
            env.yaw_tolerance = self.curriculum.yaw_tolerance
        scenes = range(env.batch_size[0])
        if tensordict is not None and "_reset" in tensordict.keys():
            mask = tensordict["_reset"].reshape(env.batch_size[0], -1).any(-1)
            scenes = mask.nonzero().flatten().tolist()
        level = None if self.curriculum.warming_up else self.curriculum.level
        self._began_at.update(dict.fromkeys(scenes, level))
        return tensordict

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        return self._write_level(tensordict_reset)

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        stepped = tensordict.get("_step", None)  # TorchRL's mask of the scenes that still run
        count = next_tensordict.batch_size.numel() if stepped is None else int(stepped.sum())
        self.curriculum.count_steps(count)
        done = read_key(next_tensordict, self.done_key)
        ended = done.flatten().nonzero().flatten().tolist()
        if ended:
            success = read_key(next_tensordict, self.success_key)
            successes = success.flatten().tolist()
        for i in ended:
            if self._began_at.pop(i, None) == self.curriculum.level:
                scene = self._env.scenarios[i].scene
                evaluated = self.evaluated_envs is None or i in self.evaluated_envs
                self.curriculum.record(successes[i], scene, evaluated=evaluated)
        return self._write_level(next_tensordict)

    def _write_level(self, tensordict: TensorDictBase) -> TensorDictBase:
        level = torch.full(
            (*tensordict.batch_size, 1),
            float(self.curriculum.level),
            dtype=torch.float32,
            device=tensordict.device or "cpu",
        )
        return tensordict.set(self.level_key, level)

    def transform_observation_spec(self, observation_spec: TensorSpec) -> TensorSpec:
        """Add the level."""
        add_unbounded(observation_spec, self.level_key, 1)
        return observation_spec

    def get_extra_state(self) -> dict[str, Any]:
        """The curriculum's state, for `state_dict`."""
        return self.curriculum.state_dict()

    def set_extra_state(self, state: Mapping[str, Any]) -> None:
        """Inverse of `get_extra_state`."""
        self.curriculum.load_state_dict(state)
