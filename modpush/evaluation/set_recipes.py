"""Distributions of the evaluation and tuning sets, and the cells of the set `hidden_dynamics`.

Source: paper Sec. V (numbers of episodes, scenes, objects, distances).
"""

import math
from dataclasses import dataclass, field, replace
from typing import Literal, NamedTuple

from modpush.envs.scenes.conditions import EpisodeConditions
from modpush.envs.scenes.layouts import (
    HARD_SCENES,
    HARD_TUNING_SCENES,
    HARD_WIDE_SCENES,
    OBSTACLE_SCENES,
)
from modpush.envs.scenes.objects import PAPER_OBJECTS, get_object
from modpush.envs.scenes.scenario import Dynamics
from modpush.envs.scenes.shape_layouts import SHAPE_SCENES

HIDDEN_SHAPES = (
    "small_cube",
    "large_cube",
    "box",
    "fragment",
    "random_24",
    "random_35",
    "random_19",
    "random_13",
)
"""Shapes: two cuboids, the box of the pose sets, the shard with a notch, and prisms with 3, 4, 5 and 6
corners."""
POSE_OBJECTS = ("small_cylinder", *HIDDEN_SHAPES)
"""Objects pushed to goal poses past obstacles: those, and a cylinder, whose yaw does not matter."""
_UNSEEN_OBJECTS = tuple(f"random_{k}" for k in range(101, 109))
_MASSES = (0.25, 0.5, 1.0, 2.0, 4.0)  # [kg]
_FRICTIONS = (0.1, 0.3, 0.5, 0.7, 0.9)  # of the object's material
_CENTERS = ((0, 0), (1, 0), (-1, 0), (0, 1), (0, -1))  # in quarters of the object's sides
_LEVELS = 5
NUM_CELLS = len(HIDDEN_SHAPES) * _LEVELS**3
"""Number of cells."""
_DISTANCES = (0.2, 0.6)  # from start to goal, in equal steps over shapes and starts [m]


class HiddenCell(NamedTuple):
    """Shape, start, distance and hidden properties of an episode."""

    shape: int  # Number of its shape
    start: int  # Number of its start, of five for each shape
    distance: float  # Distance from start to goal, which belongs to shape and start [m]
    dynamics: Dynamics  # Mass, friction and centre of mass


def hidden_cell(number: int) -> HiddenCell:
    """The cell of an episode, by its number in [0, `NUM_CELLS`)."""
    turn, shape = divmod(number, len(HIDDEN_SHAPES))
    block, place = divmod(turn, _LEVELS**2)
    mass, center = divmod(place, _LEVELS)
    start = (mass + 2 * center) % _LEVELS
    share = (start * len(HIDDEN_SHAPES) + shape + 0.5) / (_LEVELS * len(HIDDEN_SHAPES))
    low, high = _DISTANCES
    sides = get_object(HIDDEN_SHAPES[shape]).sides
    x, y = (quarter * side / 4 for quarter, side in zip(_CENTERS[center], sides, strict=True))
    dynamics = Dynamics(
        mass=_MASSES[mass],
        friction=_FRICTIONS[(mass + center + block) % _LEVELS],
        center_of_mass=(x, y),
    )
    return HiddenCell(shape, start, low + share * (high - low), dynamics)


@dataclass(frozen=True, kw_only=True)
class SetRecipe:
    """Distribution of a set's episodes. Episode i takes the i-th family and object, in turn."""

    seed: int  # Seed of the set; episode i draws from the generator of (seed, i)
    count: int  # Number of episodes
    scenes: tuple[str, ...]  # Scene families
    objects: tuple[str, ...] = ("small_cube",)  # Pushed objects
    # Range of the distance from start to goal, which is uniform [m]
    distance: tuple[float, float] = (0.2, 0.6)
    # Range of the scenes' difficulty, which is uniform
    difficulty: tuple[float, float] = (0.0, 1.0)
    path_required: bool = True  # A path past the obstacles joins start and goal
    hidden_cells: bool = False  # Dynamics, distance and start are those of `hidden_cell`
    obstacle_between: bool = False  # An obstacle stands in the straight way from start to goal
    tool_start: Literal["any", "behind"] = "any"  # Start of the tool, see `ScenarioConfig`
    # Conditions under which the episodes are run
    conditions: EpisodeConditions = field(default_factory=EpisodeConditions)


_TIGHT = EpisodeConditions(inflation="inscribed")
_SUCCESSOR = EpisodeConditions(  # those of arXiv 2403.17667
    goal="pose", position_tolerance=0.015, yaw_tolerance=math.radians(30)
)
_MOVABLE = EpisodeConditions(dynamic_obstacles=True)
_TRACKS = (4, 8, 12)  # movable objects
_COARSE = EpisodeConditions(goal="pose", position_tolerance=0.03)
_FINE = EpisodeConditions(goal="pose", position_tolerance=0.015)


def _track(seed: int, scene: str, count: int = 128) -> SetRecipe:
    return SetRecipe(
        seed=seed,
        count=count,
        scenes=(scene,),
        distance=(0.4, 0.6),
        path_required=False,
        obstacle_between=True,
        conditions=_MOVABLE,
    )


def _past_obstacles(
    seed: int, scenes: tuple[str, ...], objects: tuple[str, ...], count: int
) -> SetRecipe:
    return SetRecipe(
        seed=seed,
        count=count,
        scenes=scenes,
        objects=objects,
        distance=(0.35, 0.6),
        obstacle_between=True,
        conditions=_SUCCESSOR,
    )


def _hidden(seed: int, conditions: EpisodeConditions, count: int = NUM_CELLS) -> SetRecipe:
    return SetRecipe(
        seed=seed,
        count=count,
        scenes=("free",),
        objects=HIDDEN_SHAPES,
        hidden_cells=True,
        conditions=conditions,
    )


_RECIPES = {
    "smoke": SetRecipe(
        seed=1,
        count=20,
        scenes=("free", *OBSTACLE_SCENES, "zigzag", "random_clutter", *HARD_WIDE_SCENES),
        objects=PAPER_OBJECTS,
    ),
    "free/small_cube": SetRecipe(seed=2, count=500, scenes=("free",)),
    **{
        f"obstacles/{name}": SetRecipe(
            seed=3 + k, count=1000, scenes=OBSTACLE_SCENES, objects=(name,)
        )
        for k, name in enumerate(("small_cube", "large_cube", "small_cylinder", "fragment"))
    },
    "hard/small_cube": SetRecipe(seed=7, count=50, scenes=HARD_SCENES, conditions=_TIGHT),
    "hard200/small_cube": SetRecipe(seed=7, count=200, scenes=HARD_SCENES, conditions=_TIGHT),
    "hard_wide/small_cube": SetRecipe(seed=8, count=200, scenes=HARD_WIDE_SCENES),
    "tuning/small_cube": SetRecipe(seed=101, count=200, scenes=OBSTACLE_SCENES),
    "tuning/all_objects": SetRecipe(
        seed=102, count=200, scenes=("free", *OBSTACLE_SCENES), objects=PAPER_OBJECTS
    ),
    "pose/free/box": SetRecipe(
        seed=9,
        count=200,
        scenes=("free",),
        objects=("box",),
        conditions=EpisodeConditions(goal="pose", position_tolerance=0.015),
    ),
    **{
        f"pose/{scene}/box": _past_obstacles(10 + k, (scene,), ("box",), 500)
        for k, scene in enumerate(SHAPE_SCENES)
    },
    "pose/objects": _past_obstacles(22, tuple(SHAPE_SCENES), POSE_OBJECTS, 1008),
    "pose/unseen_objects": _past_obstacles(23, tuple(SHAPE_SCENES), _UNSEEN_OBJECTS, 1008),
    "moving/small_cube": SetRecipe(
        seed=17,
        count=200,
        scenes=("moving_bar",),
        distance=(0.35, 0.6),
        obstacle_between=True,
    ),
    **{f"tracks/{n}": _track(18 + k, f"movable_{n}") for k, n in enumerate(_TRACKS)},
    "hidden_dynamics": _hidden(21, _COARSE),
    "hidden_dynamics_fine": _hidden(21, _FINE),
    **{f"tuning/tracks/{n}": _track(104 + k, f"movable_{n}", 64) for k, n in enumerate(_TRACKS)},
    "tuning/hidden_dynamics": _hidden(107, _COARSE, 200),
    "tuning/pose/objects": _past_obstacles(108, tuple(SHAPE_SCENES), POSE_OBJECTS, 252),
    "tuning/hard": SetRecipe(seed=103, count=100, scenes=HARD_TUNING_SCENES, conditions=_TIGHT),
}
_PAPER_SETS = ("free/", "obstacles/", "hard/", "hard200/")

RECIPES = _RECIPES | {
    f"behind/{name}": replace(recipe, tool_start="behind")
    for name, recipe in _RECIPES.items()
    if name.startswith(_PAPER_SETS)
}
"""By name of the set. `hard200/small_cube` begins with the episodes of `hard/small_cube`. Those whose
name begins with `behind/` are the paper's with the tool straight behind the object, at a place with room
for the gripper and so for the rod, too: layouts and distances are those of the set named after the `/`,
and so are start and goal wherever that place is free. Those whose name begins with `tuning/` have other
seeds than the others and, where they are hard, other layouts: settings are chosen on them and on no
other set."""
