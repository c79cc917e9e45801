"""Planners by name, by "module:name" and as objects, and what they may return."""

from dataclasses import replace

import pytest
import torch

from modpush.planners import (
    PLANNERS,
    Paths,
    Planner,
    PlannerSubgoals,
    StraightLine,
    check_paths,
)
from tests.planners.table_scene import TableEnv
from tests.planners.test_transforms import SMALL, make_env

HERE = "tests.planners.test_named"


class Straight:
    """A planner that knows nothing of the library but `Paths`."""

    def plan(self, occupancy, start, goal):
        return Paths.from_waypoints(list(torch.stack([start, goal], 1)), start)


straight = Straight()


def make_straight():
    return Straight()


@pytest.mark.parametrize("name", PLANNERS)
def test_every_named_planner_plans_in_an_environment(name):
    env = make_env(2, planner=name)
    assert isinstance(env.transform[1].planner, Planner)
    assert env.rollout(3)["next", "path_length"].isfinite().all()


@pytest.mark.parametrize(
    "planner",
    [
        straight,
        Straight,
        make_straight,
        f"{HERE}:straight",
        f"{HERE}:Straight",
        f"{HERE}:make_straight",
    ],
)
def test_a_planner_of_your_own_is_found_in_every_form(planner):
    subgoals = PlannerSubgoals(planner, camera=SMALL)
    assert type(subgoals.planner).__name__ == "Straight"
    tensordict = TableEnv(2).reset()
    tensordict["occupancy"] = torch.zeros(2, 1, 64, 64, dtype=torch.bool)
    out = subgoals(tensordict)
    way = out["goal_position"] - out["object_pose"][:, :2]
    torch.testing.assert_close(out["path_length"], way.norm(dim=-1, keepdim=True))


def two_paths():
    start, goal = torch.zeros(2, 2), torch.full((2, 2), 3.0)
    return StraightLine().plan(torch.zeros(2, 4, 4, dtype=torch.bool), start, goal)


@pytest.mark.parametrize(
    ("change", "error", "message"),
    [
        (
            {"waypoints": torch.zeros(2, 2, 2).double()},
            TypeError,
            "waypoints must be a torch.float32 tensor, got torch.float64",
        ),
        (
            {"waypoints": torch.zeros(2, 1, 2)},
            ValueError,
            r"waypoints must be \[B, P, 2\] = \[2, P >= 2, 2\], got \[2, 1, 2\]",
        ),
        (
            {"waypoints": torch.full((2, 2, 2), torch.nan)},
            ValueError,
            "a waypoint is not finite",
        ),
        ({"length": torch.zeros(2, 1)}, ValueError, r"length must be \[B\] = \[2\], got \[2, 1\]"),
        ({"length": torch.full((2,), torch.inf)}, ValueError, "length of a path that was found"),
        (
            {"found": [True, True]},
            TypeError,
            "found must be a torch.bool tensor, got builtins.list",
        ),
        ({"count": torch.zeros(2)}, TypeError, "count must be a torch.int64 tensor"),
    ],
)
def test_what_does_not_fit_is_refused(change, error, message):
    with pytest.raises(error, match=message):
        check_paths(replace(two_paths(), **change), 2)


def test_a_planner_that_returns_something_else_is_named():
    class Wrong(Planner):
        def plan(self, occupancy, start, goal):
            return start, goal

    with pytest.raises(TypeError, match=r"plan must return modpush.planners.Paths, got"):
        make_env(1, planner=Wrong()).reset()
