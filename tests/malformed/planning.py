"""Planners, paths and points on them, with right arguments."""

import math

import numpy as np
import torch

from modpush import planners
from modpush.evaluation import (
    shortest_path,
)
from tests.malformed.target import BELOW_1, NOT_FINITE, NOT_POSITIVE, UNKNOWN, Target
from tests.test_validation import SCENARIO


def targets() -> list[Target]:
    """All of them."""
    return [*_plans()]


def _query() -> dict[str, torch.Tensor]:
    occupancy = torch.zeros(3, 16, 16, dtype=torch.bool)
    occupancy[:, 8, :12] = True
    goal = torch.tensor([[2.0, 14.0]]).repeat(3, 1)
    return {"occupancy": occupancy, "start": torch.full((3, 2), 2.0), "goal": goal}


def _plans() -> list[Target]:
    found = [
        Target(
            name=f"{name}.plan",
            call=lambda name=name, **query: planners.make_planner(name).plan(**query),
            given=_query,
            bad={
                "occupancy": [
                    torch.zeros(3, 5000, 2, dtype=torch.bool),
                    torch.zeros(3, 0, 16, dtype=torch.bool),
                    torch.zeros(3, 16, 16),
                    torch.zeros(3, 16, 16, dtype=torch.uint8),
                    torch.zeros(3, 16, 16, dtype=torch.complex64),
                    torch.zeros(16, 16, dtype=torch.bool),
                    torch.zeros(3, 1, 16, 16, dtype=torch.bool),
                    np.zeros((3, 16, 16), bool),
                    [[[False]]],
                    "text",
                    None,
                ],
                "start": [torch.zeros(3, 2, dtype=torch.int64), torch.zeros(0, 2)],
            },
            only=["occupancy"],  # maps of other heights and widths are right ones
        )
        for name in planners.PLANNERS
    ]
    makers = [
        Target(
            name=f"{kind.__name__}",
            call=kind,
            given=lambda kind=kind: {"cell_size": 1.0},
            bad={"cell_size": NOT_POSITIVE},
        )
        for kind in (planners.DistanceField, planners.StraightLine)
    ]
    weight = torch.ones(3, 16, 16)
    return [
        *found,
        *makers,
        Target(
            name="AStar",
            call=planners.AStar,
            given=lambda: {"cell_size": 1.0, "neighbours": 8},
            bad={"neighbours": [0, 5, "8"], "cell_size": NOT_POSITIVE},
        ),
        Target(
            name="LazyThetaStar",
            call=planners.LazyThetaStar,
            given=lambda: {"cell_size": 1.0, "nodes": "grid"},
            bad={"nodes": UNKNOWN, "cell_size": NOT_POSITIVE},
        ),
        Target(
            name="AStar.plan_weighted",
            call=planners.AStar().plan_weighted,
            given=lambda: {**_query(), "weight": torch.ones(3, 16, 16)},
            bad={"weight": [-weight, weight * 0, weight * math.nan, weight * math.inf]},
        ),
        Target(
            name="make_planner",
            call=lambda planner: planners.make_planner(planner),
            given=lambda: {"planner": "a_star"},
            bad={"planner": [*UNKNOWN, 3, None, object(), "os:getcwd", list]},
            only=["planner"],
        ),
        Target(
            name="warmup",
            call=planners.warmup,
            given=lambda: {"height": 16, "width": 16},
            bad={"height": BELOW_1, "width": BELOW_1},
        ),
        Target(
            name="point_along",
            call=planners.point_along,
            given=lambda: {"waypoints": torch.rand(3, 4, 2), "distance": torch.ones(3)},
            bad={
                "distance": [
                    torch.ones(4),
                    torch.ones(3, 1),
                    torch.full((3,), math.nan),
                    torch.ones(3, dtype=torch.complex64),
                    torch.ones(3, dtype=torch.bool),
                    None,
                    "text",
                ]
            },
            only=["distance"],  # past the end is right, infinity too
        ),
        *_subgoals(),
        Target(
            name="shortest_path",
            call=shortest_path,
            given=lambda: {"scenario": SCENARIO, "planner": planners.AStar()},
            bad={"scenario": [None, "free", {}], "planner": [*UNKNOWN, 3, object()]},
            only=["scenario", "planner"],
        ),
    ]


def _subgoals() -> list[Target]:
    paths = planners.AStar().plan(**_query())
    right = torch.rand(4, 2)
    return [
        Target(
            name="fraction_subgoal",
            call=planners.fraction_subgoal,
            given=lambda: {"paths": paths, "fraction": 0.2},
            bad={"fraction": [-0.1, 1.5, *NOT_FINITE], "paths": [None, 3, right]},
        ),
        Target(
            name="lookahead_subgoal",
            call=planners.lookahead_subgoal,
            given=lambda: {"paths": paths, "distance": 2.0},
            bad={"distance": [-0.1, *NOT_FINITE], "paths": [None, 3, right]},
        ),
        Target(
            name="check_paths",
            call=lambda batch, **fields: planners.check_paths(
                "it", planners.Paths(**fields), batch
            ),
            given=lambda: {**vars(paths), "batch": 3},
            bad={"batch": [2, 4]},
            only=["batch"],
            also={"batch": ["waypoints"]},
        ),
        Target(
            name="Paths.from_waypoints",
            call=planners.Paths.from_waypoints,
            given=lambda: {"paths": [right, None], "start": torch.zeros(2, 2), "cell_size": 1.0},
            bad={
                "paths": [[right], [right[:1], None], [right[:, :1], None], 3, [3, None]],
                "cell_size": NOT_POSITIVE,
            },
            only=["paths"],
        ),
    ]
