"""The evaluation sets: fixed episodes in versioned files, and their generator.

    python -m modpush.evaluation.sets            # writes the files anew, bit for bit the same
    python -m modpush.evaluation.sets --check    # compares them instead

What they are drawn from is in `set_recipes.py`.
"""

import argparse
import re
from collections.abc import Collection, Iterator, Sequence
from dataclasses import field, replace
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np

from modpush._state import data_hash
from modpush._types import Count, Name, NonNegativeInteger, Several
from modpush._validation import checked, checked_arguments
from modpush.envs.scenes.arm_room import within_reach
from modpush.envs.scenes.conditions import SENSING, EpisodeConditions, SensingName
from modpush.envs.scenes.sampling import sample_scenario
from modpush.envs.scenes.scenario import Dynamics, Scenario, ScenarioConfig
from modpush.evaluation.set_recipes import RECIPES, SetRecipe, hidden_cell
from modpush.files import read_packed_json, reading, write_packed_json
from modpush.parts import check_allowed

SET_VERSION = 4
"""Version of the files; another number means other episodes, or another form."""
_KIND = "modpush.EvaluationSet"
_NAME = re.compile(r"[\w+-][\w.+-]*(/[\w+-][\w.+-]*)*")
_DECIMALS = 6  # micrometres and microradians: exact enough, and the same on every machine


SET_NAMES = tuple(RECIPES)
"""Names of all sets in the package."""
TUNING_SETS = tuple(name for name in SET_NAMES if name.startswith("tuning/"))
"""Names of the sets that settings are chosen on. Nothing is evaluated on them."""
BEHIND_SETS = tuple(name for name in SET_NAMES if name.startswith("behind/"))
"""Names of the sets of the paper in which the tool starts straight behind the object, as in the code of
its authors. Nothing is chosen on them."""
EVALUATION_SETS = tuple(
    name for name in SET_NAMES if name.startswith(("free/", "obstacles/", "hard"))
)
"""Names of the sets with goal positions, past obstacles that stand, that methods are evaluated on.

Nothing is chosen on them, nor on those with goal poses, moving or movable obstacles or hidden dynamics.
"""


@checked
class EvaluationSet:
    """Numbered episodes on which every method is evaluated."""

    name: str
    """Letters, digits and `_.+-`, in parts separated by `/`: results are kept in a folder of this
    name."""
    scenarios: Several[Scenario]
    """Episode i starts from `scenarios[i]`. Any first part of a set holds its families and objects
    in equal shares."""
    conditions: EpisodeConditions = field(default_factory=EpisodeConditions)
    """Time limit, robot, tool, physics and map with which every method runs the episodes."""
    version: Count = SET_VERSION
    digest: str = ""
    """Hash of all episodes of the set that this is the first part of; computed if not given."""

    def __post_init__(self) -> None:
        if not _NAME.fullmatch(self.name):
            raise ValueError(
                "EvaluationSet: name must be letters, digits and _.+- in parts separated by '/', "
                f"none of which begins with a dot, got {self.name!r}."
            )
        poses = self.conditions.goal == "pose"
        for number, scenario in enumerate(self.scenarios):
            if poses != (scenario.goal_yaw is not None):
                raise ValueError(
                    f"EvaluationSet: scenarios[{number}] must have {'a' if poses else 'no'} goal_yaw "
                    f"with goal={self.conditions.goal!r} in the conditions, got {scenario.goal_yaw}."
                )
        if not self.digest:
            episodes = data_hash([scenario.to_dict() for scenario in self.scenarios])
            object.__setattr__(self, "digest", episodes)

    def __len__(self) -> int:
        return len(self.scenarios)

    def __iter__(self) -> Iterator[Scenario]:
        return iter(self.scenarios)

    @property
    def objects(self) -> tuple[str, ...]:
        """Names of the objects that are pushed, each once, in order of appearance."""
        return tuple(dict.fromkeys(s.pushed_object for s in self.scenarios))

    @property
    def hides_dynamics(self) -> bool:
        """The objects' friction or centre of mass is not always the usual one."""
        usual = Dynamics()
        return any(
            (s.dynamics.friction, s.dynamics.center_of_mass)
            != (usual.friction, usual.center_of_mass)
            for s in self.scenarios
        )

    @checked_arguments
    def first(self, count: Count | None) -> "EvaluationSet":
        """The first `count` episodes; all of them for None.

        Raises:
            ValueError: If `count` is not positive.
        """
        return replace(self, scenarios=self.scenarios[:count])

    @checked_arguments
    def with_conditions(
        self,
        *,
        robot: Name | None = None,
        tool: Name | None = None,
        engine: Name | None = None,
        sensing: SensingName | None = None,
    ) -> "EvaluationSet":
        """The same episodes under other conditions; the set's name then ends with `+<name>` of each.

        Starts and layouts stay as they were drawn, for the set's own arm and tool; `within_reach` leaves
        out the episodes that another arm cannot begin.

        Args:
            robot: Arm: its name, or `module:name`.
            tool: Tool of the arm.
            engine: Physics engine, which runs at its own rate.
            sensing: Delays and noise between policy and world, for agents; a name in `SENSING`.

        Raises:
            ValueError: If there is no such robot, tool, engine or sensing.
        """
        name, conditions = self.name, self.conditions
        given = {"robot": robot, "tool": tool, "engine": engine, "sensing": sensing}
        for field_name, value in given.items():
            if value is None:
                continue
            changes: dict[str, Any] = {field_name: value}
            if field_name == "sensing":
                changes = {"sensing": SENSING[value]}  # type: ignore[index]  # checked above
            elif field_name == "engine":
                changes["sim_freq"] = None
            if getattr(conditions, field_name) != changes[field_name]:
                conditions = replace(conditions, **changes)
                name = f"{name}+{value.rpartition(':')[2]}"
        if name == self.name:
            return self
        return replace(self, name=name, conditions=conditions)

    def within_reach(self) -> "EvaluationSet":
        """The episodes that the set's own arm can begin with its tool; see `modpush.envs.within_reach`.

        They are numbered anew. The set itself if it can begin them all.
        """
        kept = within_reach(self.scenarios, self.conditions.robot, self.conditions.tool)
        return self if len(kept) == len(self) else replace(self, scenarios=tuple(kept), digest="")

    def save(self, path: Path) -> None:
        """Write the set as gzip-compressed JSON; the same set always gives the same bytes."""
        content = {
            "name": self.name,
            "conditions": self.conditions.to_dict(),
            "episodes": [s.to_dict() for s in self.scenarios],
        }
        if self.digest != data_hash(content["episodes"]):  # the first part of a larger set
            content["digest"] = self.digest
        write_packed_json(path, content)


@checked_arguments
def load_set(name: str | Path, *, allow: Collection[str] = ()) -> EvaluationSet:
    """Read an evaluation set: one of the package by its name, or your own file by its path.

    Args:
        name: One of `SET_NAMES`, or the path of a file that `EvaluationSet.save` wrote.
        allow: Modules and packages from which the file may name objects and scenes, `"module:name"`.

    Raises:
        ValueError: If there is no such set (the message lists the known ones), or if the file is
            damaged, no evaluation set, of another version, or names modules that are not allowed.
    """
    if isinstance(name, str) and name in RECIPES:
        source = Path(str(files("modpush.evaluation"))) / "data" / f"{name}.json.gz"
    else:
        source = Path(name)
    if not source.is_file():
        raise ValueError(
            f"load_set: no set {str(name)!r}, expected one of {list(SET_NAMES)} or a file's path."
        )
    with reading(source, _KIND):
        content = read_packed_json(source, _KIND)
        if not isinstance(content, dict) or not {"name", "conditions", "episodes"} <= set(content):
            raise ValueError(f"load_set: {source} must hold a name, conditions and episodes.")
        check_allowed(f"load_set: {source}", [content["episodes"], content["conditions"]], allow)
        return EvaluationSet(
            name=content["name"],
            scenarios=tuple(Scenario.from_dict(episode) for episode in content["episodes"]),
            conditions=EpisodeConditions.from_dict(content["conditions"]),
            digest=content.get("digest", ""),
        )


@checked_arguments
def generate_set(name: str, episodes: Sequence[NonNegativeInteger] | None = None) -> EvaluationSet:
    """Draw a set, or some of its episodes. Each episode has its own generator, from set and number.

    Args:
        name: One of `SET_NAMES`.
        episodes: Numbers of the episodes; None for all.

    Raises:
        ValueError: If there is no such set; the message lists the known ones.
    """
    if name not in RECIPES:
        raise ValueError(f"generate_set: name must be one of {list(SET_NAMES)}, got {name!r}.")
    recipe = RECIPES[name]
    numbers = range(recipe.count) if episodes is None else episodes
    return EvaluationSet(
        name=name,
        scenarios=tuple(_draw(recipe, i) for i in numbers),
        conditions=recipe.conditions,
    )


def _draw(recipe: SetRecipe, number: int) -> Scenario:
    config = ScenarioConfig(
        scene=recipe.scenes[number % len(recipe.scenes)],
        pushed_object=recipe.objects[number % len(recipe.objects)],
        difficulty=recipe.difficulty,
        distance=recipe.distance,
        path_inflation=recipe.conditions.inflation,
        path_required=recipe.path_required,
        obstacle_between=recipe.obstacle_between,
        tool_start=recipe.tool_start,
    )
    source = [recipe.seed, number]
    if recipe.hidden_cells:
        cell = hidden_cell(number)
        config = replace(config, distance=cell.distance)
        source = [recipe.seed, cell.shape, cell.start]
    rng = np.random.default_rng(source)
    conditions = recipe.conditions
    drawn = sample_scenario(rng, config, tool=conditions.tool, goal=conditions.goal)
    if recipe.hidden_cells:
        drawn = replace(drawn, dynamics=cell.dynamics)
    return Scenario.from_dict(_rounded(drawn.to_dict()))


def _rounded(value: Any) -> Any:
    if isinstance(value, float):
        return round(value, _DECIMALS)
    if isinstance(value, dict):
        return {key: _rounded(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_rounded(item) for item in value]
    return value


def main() -> None:
    """Write the package's files, or compare them with what the generator draws."""
    parser = argparse.ArgumentParser(description="Generate the evaluation sets.")
    parser.add_argument("--check", action="store_true", help="compare instead of writing")
    parser.add_argument("--out", type=Path, default=Path(__file__).parent / "data")
    args = parser.parse_args()
    for name in SET_NAMES:
        drawn = generate_set(name)
        path = args.out / f"{name}.json.gz"
        if args.check:
            same = load_set(path) == drawn
            print(f"{name}: {'the same' if same else 'DIFFERS'}")
            if not same:
                raise SystemExit(1)
        else:
            drawn.save(path)
            print(f"{name}: {len(drawn)} episodes, {path.stat().st_size / 1000:.0f} kB")


if __name__ == "__main__":
    main()
