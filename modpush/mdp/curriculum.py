"""From short pushes in free space to long ones through clutter, as fast as the agent learns."""

from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import torch
from tensordict import TensorDictBase
from torchrl.data import TensorSpec, Unbounded
from torchrl.envs import Transform

from modpush.envs.scenes.layouts import OBSTACLE_SCENES
from modpush.envs.scenes.scenario import ScenarioConfig

__all__ = ["Curriculum", "CurriculumConfig", "CurriculumScenes", "Phase"]

_DISTANCES = (0.06, 0.08, 0.13, 0.18, 0.23, 0.28, 0.33, 0.38, 0.43, 0.48, 0.53, 0.60)
_FAMILY_MEMORY = 100  # episodes a family's success is taken over


@dataclass(frozen=True, kw_only=True)
class Phase:
    """A part of the curriculum with its own scene families."""

    scenes: tuple[str, ...]
    """Families drawn from, one an episode."""
    first_stage: int = 0
    """Stage that it begins with."""


@dataclass(frozen=True, kw_only=True)
class CurriculumConfig:
    """Stages of distance, phases of scenes, and when to go on (paper Sec. IV-B; spec 8)."""

    distances: tuple[float, ...] = _DISTANCES
    """Stage s draws the distance from start to goal from [distances[s - 2], distances[s]] [m]."""
    final_distance: tuple[float, float] = (0.2, 0.6)
    """What the last stage draws from [m]."""
    phases: tuple[Phase, ...] = (
        Phase(scenes=("free",)),
        Phase(scenes=("free", *OBSTACLE_SCENES), first_stage=6),
    )
    """One after the other; each ends with its last stage."""
    promotion: Literal["success", "steps", "off"] = "success"
    """Go on by success, at given numbers of steps, or begin with the last stage of the last phase."""
    threshold: float = 0.7
    """Success to go on at, over `window` episodes."""
    window: int = 40
    """Episodes of the present stage that are judged."""
    step_thresholds: tuple[int, ...] = ()
    """For `"steps"`: environment steps after which the second, third, ... stage begins, counted
    through all phases."""

    def __post_init__(self) -> None:
        """Check the ranges."""
        ascending = all(a < b for a, b in zip(self.distances, self.distances[1:], strict=False))
        if not self.distances or not ascending or not self.distances[0] > 0:
            raise ValueError(
                f"CurriculumConfig: distances must be positive and ascending, got {self.distances}."
            )
        if not 0 < self.final_distance[0] <= self.final_distance[1]:
            raise ValueError(
                "CurriculumConfig: final_distance must be a range of positive lengths, got "
                f"{self.final_distance}."
            )
        if not self.phases:
            raise ValueError("CurriculumConfig: phases is empty, expected at least one.")
        for phase in self.phases:
            if not 0 <= phase.first_stage < len(self.distances):
                raise ValueError(
                    "CurriculumConfig: first_stage must be in "
                    f"[0, {len(self.distances) - 1}], got {phase.first_stage}."
                )
        if self.promotion not in ("success", "steps", "off"):
            raise ValueError(
                "CurriculumConfig: promotion must be 'success', 'steps' or 'off', got "
                f"{self.promotion!r}."
            )
        if not 0 < self.threshold <= 1:
            raise ValueError(
                f"CurriculumConfig: threshold must be in (0, 1], got {self.threshold}."
            )
        if self.window < 1:
            raise ValueError(f"CurriculumConfig: window must be >= 1, got {self.window}.")
        if self.promotion == "steps" and not self.step_thresholds:
            raise ValueError("CurriculumConfig: promotion 'steps' needs step_thresholds, got none.")
        if list(self.step_thresholds) != sorted(self.step_thresholds):
            raise ValueError(
                f"CurriculumConfig: step_thresholds must ascend, got {self.step_thresholds}."
            )


class Curriculum:
    """Where the learner stands, and what episodes are drawn there.

    Args:
        config: Stages, phases and when to go on.
    """

    def __init__(self, config: CurriculumConfig | None = None) -> None:
        self.config = config or CurriculumConfig()
        self.phase, self.stage = 0, self.config.phases[0].first_stage
        if self.config.promotion == "off":
            self.phase, self.stage = len(self.config.phases) - 1, len(self.config.distances) - 1
        self.steps = 0
        self._judged: deque[bool] = deque(maxlen=self.config.window)
        self._families: dict[str, deque[bool]] = {}

    @property
    def level(self) -> int:
        """Stages passed, through all phases."""
        before = self.config.phases[: self.phase]
        passed = sum(len(self.config.distances) - phase.first_stage for phase in before)
        return passed + self.stage - self.config.phases[self.phase].first_stage

    @property
    def finished(self) -> bool:
        """Whether this is the last stage of the last phase."""
        last = len(self.config.distances) - 1
        return self.phase == len(self.config.phases) - 1 and self.stage == last

    def scenario(self, base: ScenarioConfig) -> ScenarioConfig:
        """What episodes are drawn from now: `base` with scenes, difficulty and distance replaced."""
        distances, stage = self.config.distances, self.stage
        distance = (distances[max(stage - 2, 0)], distances[stage])
        if stage == len(distances) - 1:
            distance = self.config.final_distance
        return replace(
            base,
            scene=self.config.phases[self.phase].scenes,
            difficulty=(0.0, (stage + 1) / len(distances)),
            distance=distance,
        )

    def record(self, success: bool, scene: str, *, judged: bool = True) -> None:
        """Take note of an episode of the present stage; goes on if that was enough.

        Args:
            success: Whether it reached its goal.
            scene: Its family.
            judged: Whether it counts for going on.
        """
        self._families.setdefault(scene, deque(maxlen=_FAMILY_MEMORY)).append(success)
        if not judged:
            return
        self._judged.append(success)
        if (
            self.config.promotion == "success"
            and len(self._judged) == self.config.window
            and self.success >= self.config.threshold
        ):
            self._go_on()

    def count_steps(self, steps: int) -> None:
        """Take note of environment steps; goes on where the config says so."""
        self.steps += steps
        if self.config.promotion == "steps":
            while self.level < sum(self.steps >= s for s in self.config.step_thresholds):
                if self.finished:
                    break
                self._go_on()

    def _go_on(self) -> None:
        if self.finished:
            return
        if self.stage < len(self.config.distances) - 1:
            self.stage += 1
        else:
            self.phase += 1
            self.stage = self.config.phases[self.phase].first_stage
        self._judged.clear()

    @property
    def success(self) -> float:
        """Over the judged episodes of this stage, at most `window` of them; 0 before the first."""
        return sum(self._judged) / max(1, len(self._judged))

    @property
    def family_success(self) -> dict[str, float]:
        """Success of the last episodes of each family that was drawn, judged or not."""
        return {name: sum(seen) / len(seen) for name, seen in self._families.items()}

    def state_dict(self) -> dict[str, Any]:
        """Plain numbers and lists."""
        return {
            "phase": self.phase,
            "stage": self.stage,
            "steps": self.steps,
            "judged": list(self._judged),
            "families": {name: list(seen) for name, seen in self._families.items()},
        }

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Inverse of `state_dict`.

        Raises:
            ValueError: If the state is of a curriculum with more phases or stages.
        """
        phases, stages = len(self.config.phases), len(self.config.distances)
        if state["phase"] >= phases or state["stage"] >= stages:
            raise ValueError(
                f"Curriculum: the state is at phase {state['phase']}, stage {state['stage']}; this "
                f"curriculum has {phases} phases of {stages} stages."
            )
        self.phase, self.stage, self.steps = state["phase"], state["stage"], state["steps"]
        self._judged = deque(state["judged"], maxlen=self.config.window)
        self._families = {
            name: deque(seen, maxlen=_FAMILY_MEMORY) for name, seen in state["families"].items()
        }


class CurriculumScenes(Transform):
    """Draws a `PushEnv`'s episodes from a curriculum, and tells it how they end.

    An episode that began before the present stage does not count for it. The curriculum's state is
    part of the environment's `state_dict`.

    Args:
        curriculum: Asked at each reset, told at each end.
        judged: Scenes whose episodes count for going on, such as those that act greedily; default
            all.
        level_key: Written, `[..., 1]` float32: the curriculum's level.
    """

    def __init__(
        self,
        curriculum: Curriculum,
        *,
        judged: Sequence[int] | None = None,
        level_key: str = "curriculum_level",
    ) -> None:
        super().__init__(in_keys=["success", "done"], out_keys=[level_key])
        self.curriculum = curriculum
        self.judged = None if judged is None else frozenset(judged)
        self.level_key = level_key
        self._base: ScenarioConfig | None = None
        self._began_at: dict[int, int] = {}

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
        if self._base is None:
            self._base = env.scenario
        env.scenario = self.curriculum.scenario(self._base)
        scenes = range(env.batch_size[0])
        if tensordict is not None and "_reset" in tensordict.keys():
            mask = tensordict["_reset"].reshape(env.batch_size[0], -1).any(-1)
            scenes = mask.nonzero().flatten().tolist()
        self._began_at.update(dict.fromkeys(scenes, self.curriculum.level))
        return tensordict

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        return self._write_level(tensordict_reset)

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        self.curriculum.count_steps(next_tensordict.batch_size.numel())
        ended = next_tensordict["done"].flatten().nonzero().flatten().tolist()
        success = next_tensordict["success"].flatten().tolist() if ended else []
        for i in ended:
            if self._began_at.get(i) == self.curriculum.level:
                scene = self._env.scenarios[i].scene
                judged = self.judged is None or i in self.judged
                self.curriculum.record(success[i], scene, judged=judged)
        return self._write_level(next_tensordict)

    def _write_level(self, tensordict: TensorDictBase) -> TensorDictBase:
        level = torch.full((*tensordict.batch_size, 1), float(self.curriculum.level))
        return tensordict.set(self.level_key, level)

    def transform_observation_spec(self, observation_spec: TensorSpec) -> TensorSpec:
        """Add the level."""
        observation_spec[self.level_key] = Unbounded(
            shape=(*observation_spec.shape, 1), dtype=torch.float32, device=observation_spec.device
        )
        return observation_spec

    def get_extra_state(self) -> dict[str, Any]:
        """The curriculum's state, for `state_dict`."""
        return self.curriculum.state_dict()

    def set_extra_state(self, state: Mapping[str, Any]) -> None:
        """Inverse of `get_extra_state`."""
        self.curriculum.load_state_dict(state)
