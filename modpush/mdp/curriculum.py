"""From short pushes in free space to long ones through clutter, as fast as the agent learns."""

from collections import deque
from collections.abc import Mapping
from dataclasses import replace
from typing import Any, Literal

from modpush._checks import check_instance
from modpush._types import (
    AtLeastOne,
    Count,
    Name,
    NonNegativeInteger,
    PositiveFraction,
    Several,
    YawTolerance,
)
from modpush._validation import check_value, checked, checked_arguments, from_plain
from modpush.envs.outcome import GOAL_THRESHOLD
from modpush.envs.scenes.layouts import ALL_SCENES
from modpush.envs.scenes.scenario import GoalDistance, GoalDistances, ScenarioConfig
from modpush.parts import check_part

_DISTANCES = (0.06, 0.08, 0.13, 0.18, 0.23, 0.28, 0.33, 0.38, 0.43, 0.48, 0.53, 0.60)
_SCENE_WINDOW = 100
"""Number of the last episodes of a scene over which its success rate is taken."""


@checked
class Phase:
    """A part of the curriculum with scenes of its own."""

    scenes: Several[Name] = ()
    """Scenes of the phase, by name or as "module:name"; one is drawn for each episode. Empty for the
    environment's own scenes."""
    first_stage: NonNegativeInteger = 0
    """Stage that the phase begins with, counted from 0."""

    def __post_init__(self) -> None:
        for name in self.scenes:
            check_part("Phase: scenes", name, ALL_SCENES)


@checked
class CurriculumConfig:
    """Curriculum from short pushes to long ones; the defaults are the paper's (Sec. IV-B).

    The paper gives the first and the last distance, 0.06 and 0.6 m, but neither the distances between
    them nor when the next stage begins.
    """

    distances: AtLeastOne[GoalDistance] = _DISTANCES
    """Distances from start to goal [m]: stage s draws from [distances[s - 2], distances[s]]. Those
    between the first and the last are from the authors' code."""
    final_distance: GoalDistances = (0.2, 0.6)
    """Range of the distance from start to goal in the last stage [m]: by default that of the
    paper's evaluation."""
    phases: AtLeastOne[Phase] = (Phase(),)
    """Phases, one after the other; each ends with the last stage. By default there is one, with the
    environment's own scenes."""
    yaw_tolerances: Several[YawTolerance] = ()
    """Yaw tolerances for goal poses [rad], through which the last stage of the last phase goes: the next
    one follows as soon as `threshold` of the last `window` episodes have succeeded. Empty for the
    environment's own."""
    promotion: Literal["success", "off"] = "success"
    """Event that begins the next stage: "success" (enough episodes of this stage succeeded), or "off" (no
    curriculum: training begins with the last stage of the last phase and stays there). The paper gives
    no rule; its authors' code counts steps."""
    threshold: PositiveFraction = 0.7
    """Success rate over the last `window` episodes at which the next stage begins."""
    window: Count = 40
    """Number of episodes of a stage over which its success rate is taken."""

    def __post_init__(self) -> None:
        ascending = all(a < b for a, b in zip(self.distances, self.distances[1:], strict=False))
        if not ascending:
            raise ValueError(
                f"CurriculumConfig: distances must be ascending, got {self.distances}."
            )
        if self.distances[0] <= GOAL_THRESHOLD:
            raise ValueError(
                f"CurriculumConfig: distances must be greater than {GOAL_THRESHOLD} m, where an "
                f"episode has succeeded already, got {self.distances[0]}."
            )
        pairs = zip(self.yaw_tolerances, self.yaw_tolerances[1:], strict=False)
        if not all(a > b for a, b in pairs):
            raise ValueError(
                f"CurriculumConfig: yaw_tolerances must be descending, got {self.yaw_tolerances}."
            )
        for phase in self.phases:
            if phase.first_stage >= len(self.distances):
                raise ValueError(
                    "CurriculumConfig: first_stage must be in "
                    f"[0, {len(self.distances) - 1}], got {phase.first_stage}."
                )


@checked
class _State:
    """State of a `Curriculum`."""

    phase: NonNegativeInteger
    stage: NonNegativeInteger
    narrowings: NonNegativeInteger
    steps: NonNegativeInteger
    successes: Several[bool]
    scene_successes: dict[str, list[bool]]


class Curriculum:
    """The present stage of training, and the episodes that are drawn in it.

    Args:
        config: Stages, phases and when the next stage begins.
        warm_up: Number of environment steps at the beginning in which another policy acts instead of the
            agent. Their episodes have the distances of the final stage and the present phase's scenes,
            and do not count towards the next stage.
    """

    @checked_arguments
    def __init__(
        self, config: CurriculumConfig | None = None, *, warm_up: NonNegativeInteger = 0
    ) -> None:
        self.config = config or CurriculumConfig()
        self.warm_up = warm_up
        self.phase = 0
        """Index of the present phase."""
        self.stage = self.config.phases[0].first_stage
        """Index of the present stage within all stages of distance."""
        if self.config.promotion == "off":
            self.phase, self.stage = len(self.config.phases) - 1, len(self.config.distances) - 1
        self.narrowings = 0
        """Index of the present yaw tolerance within all of them."""
        self.steps = 0
        """Environment steps so far."""
        self._successes: deque[bool] = deque(maxlen=self.config.window)
        self._scene_successes: dict[str, deque[bool]] = {}

    @property
    def level(self) -> int:
        """Number of stages and yaw tolerances passed, through all phases."""
        before = self.config.phases[: self.phase]
        passed = sum(len(self.config.distances) - phase.first_stage for phase in before)
        return passed + self.stage - self.config.phases[self.phase].first_stage + self.narrowings

    @property
    def yaw_tolerance(self) -> float | None:
        """The present yaw tolerance for goal poses [rad]; None for the environment's own."""
        tolerances = self.config.yaw_tolerances
        return tolerances[self.narrowings] if tolerances else None

    @property
    def warming_up(self) -> bool:
        """True while another policy acts instead of the agent; episodes begun then do not count."""
        return self.steps < self.warm_up

    @property
    def finished(self) -> bool:
        """True in the last stage of the last phase, whatever the yaw tolerance."""
        last = len(self.config.distances) - 1
        return self.phase == len(self.config.phases) - 1 and self.stage == last

    def scenario(self, base: ScenarioConfig) -> ScenarioConfig:
        """Settings of the present stage: `base` with scenes, difficulty and distance replaced.

        Args:
            base: The environment's own. Its scenes stay in a phase that has none, and the difficulty
                grows from the least of its range to the largest.
        """
        distances, stage = self.config.distances, self.stage
        if self.warming_up:
            stage = len(distances) - 1
        distance = (distances[max(stage - 2, 0)], distances[stage])
        if stage == len(distances) - 1:
            distance = self.config.final_distance
        check_instance("base", base, ScenarioConfig)
        easiest, hardest = base.difficulty
        return replace(
            base,
            scene=self.config.phases[self.phase].scenes or base.scene,
            difficulty=(
                easiest,
                easiest + (hardest - easiest) * (stage + 1) / len(distances),
            ),
            distance=distance,
        )

    @checked_arguments
    def record(self, success: bool, scene: str, *, evaluated: bool = True) -> None:
        """Take note of an episode of the present stage; begins the next stage if that was enough.

        Args:
            success: True if the object reached the goal.
            scene: Name of the episode's scene.
            evaluated: True if the episode counts towards the next stage.
        """
        self._scene_successes.setdefault(scene, deque(maxlen=_SCENE_WINDOW)).append(success)
        if not evaluated:
            return
        self._successes.append(success)
        if len(self._successes) < self.config.window or self.success_rate < self.config.threshold:
            return
        if self.finished:
            self._narrow()
        else:
            self._advance()

    def count_steps(self, steps: int) -> None:
        """Take note of environment steps."""
        check_value("steps", steps, NonNegativeInteger)
        self.steps += steps

    def _advance(self) -> None:
        if self.stage < len(self.config.distances) - 1:
            self.stage += 1
        else:
            self.phase += 1
            self.stage = self.config.phases[self.phase].first_stage
        self._successes.clear()

    def _narrow(self) -> None:
        if self.narrowings < len(self.config.yaw_tolerances) - 1:
            self.narrowings += 1
            self._successes.clear()

    @property
    def success_rate(self) -> float:
        """Success rate of the last `window` evaluated episodes of this stage; 0 before the first."""
        return sum(self._successes) / max(1, len(self._successes))

    @property
    def scene_success_rates(self) -> dict[str, float]:
        """Success rate of the last 100 episodes of each scene, whether they were evaluated or not."""
        return {name: sum(last) / len(last) for name, last in self._scene_successes.items()}

    def state_dict(self) -> dict[str, Any]:
        """The state as plain numbers and lists, ready for JSON."""
        return {
            "phase": self.phase,
            "stage": self.stage,
            "narrowings": self.narrowings,
            "steps": self.steps,
            "successes": list(self._successes),
            "scene_successes": {name: list(last) for name, last in self._scene_successes.items()},
        }

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Inverse of `state_dict`.

        Raises:
            ValueError: If a field is missing or malformed, or the state is of a curriculum with other
                phases or stages.
        """
        found = from_plain(_State, {"narrowings": 0, **state})  # older states have none
        phases, stages = self.config.phases, len(self.config.distances)
        first = phases[min(found.phase, len(phases) - 1)].first_stage
        last = max(0, len(self.config.yaw_tolerances) - 1)
        if (
            found.phase >= len(phases)
            or not first <= found.stage < stages
            or found.narrowings > last
        ):
            raise ValueError(
                f"Curriculum: expected a state in one of {len(phases)} phases, here of stages {first} to "
                f"{stages - 1}, and with at most {last} narrowings, got {dict(state)}."
            )
        self.phase, self.stage, self.narrowings = found.phase, found.stage, found.narrowings
        self.steps = found.steps
        self._successes = deque(found.successes, maxlen=self.config.window)
        self._scene_successes = {
            name: deque(last, maxlen=_SCENE_WINDOW) for name, last in found.scene_successes.items()
        }
