"""OccupancyGrid and PlannerSubgoals as TorchRL transforms: on envs, in workers, on stored data."""

import math
from dataclasses import replace

import pytest
import torch
from box_images import render, square
from tensordict import TensorDict
from torchrl.data import LazyTensorStorage, ReplayBuffer
from torchrl.envs import Compose, TransformedEnv, check_env_specs
from torchrl.envs.transforms import RenameTransform

from modpush.envs import PushEnv
from modpush.envs.scenes.obstacle import Obstacle
from modpush.envs.scenes.scenario import Dynamics, Scenario
from modpush.geometry import CAMERA, Camera, Label
from modpush.planners import (
    DistanceField,
    LazyThetaStar,
    OccupancyGrid,
    Paths,
    Planner,
    PlannerSubgoals,
    fraction_subgoal,
    lookahead_subgoal,
    occupancy,
    points_ahead,
)
from modpush.planners.occupancy_map import are_connected
from tests.planners.table_scene import TableEnv

SMALL = Camera(height=64, width=64)
WRITTEN = ["path_length", "subgoal", "subgoal_past", "path_found", "subgoal_history"]


def make_env(num_envs=None, planner=None, **kwargs):
    return TransformedEnv(
        TableEnv(num_envs),
        Compose(
            OccupancyGrid(camera=SMALL),
            PlannerSubgoals(planner or DistanceField(), camera=SMALL, **kwargs),
        ),
    )


def steer(tensordict, direction):
    action = torch.zeros(*tensordict.batch_size, 2)
    action[...] = torch.tensor(direction)
    return tensordict.set("action", action)


def check_row_by_row(env, rollout):
    """Each step's outputs are what the planner says of that step's inputs alone."""
    flat = rollout.reshape(-1)
    planner = LazyThetaStar(cell_size=SMALL.cell_size)
    paths = planner.plan(
        flat["occupancy"][:, 0],
        SMALL.project(flat["object_pose"][:, :2]),
        SMALL.project(flat["goal_position"]),
    )
    torch.testing.assert_close(flat["path_length"][:, 0], paths.length)
    subgoal = SMALL.unproject(fraction_subgoal(paths, 0.2))
    torch.testing.assert_close(flat["subgoal"], subgoal, atol=1e-5, rtol=1e-5)


@pytest.mark.parametrize("num_envs", [None, 1, 3])
@pytest.mark.parametrize("mode", ["fraction", "lookahead"])
def test_specs_hold(num_envs, mode):
    check_env_specs(make_env(num_envs, mode=mode, max_waypoints=12))


def test_lags_by_hand():
    env = make_env(lags=(0, 1, 5))
    tensordict = env.reset()
    first = tensordict["subgoal"].clone()
    assert (tensordict["subgoal_past"] == first).all()
    seen = [first]
    for k in range(9):
        tensordict = env.step(steer(tensordict, [0.1, 0.7]))["next"]
        seen.append(tensordict["subgoal"].clone())
        expected = [seen[k + 1], seen[k], seen[max(k + 1 - 5, 0)]]
        assert torch.equal(tensordict["subgoal_past"], torch.stack(expected))
    assert len({tuple(subgoal.tolist()) for subgoal in seen}) == len(seen)


def test_every_step_is_planned_from_what_that_step_saw():
    env = make_env(2)
    rollout = env.rollout(12, lambda td: steer(td, [0.4, 0.4]), break_when_any_done=False)
    check_row_by_row(env, rollout)
    assert rollout["path_found"].all()
    assert rollout["path_length"].min() > 0.3


def test_a_scene_s_reset_leaves_the_others_alone():
    env = make_env(3)
    tensordict = env.reset()
    for _ in range(4):
        tensordict = env.step(steer(tensordict, [0.2, 0.8]))["next"]
    before = tensordict.clone()
    mask = torch.tensor([[False], [True], [False]])
    after = env.reset(tensordict.clone().set("_reset", mask))
    for key in [*WRITTEN, "occupancy", "blocked_bits"]:
        assert torch.equal(after[key][[0, 2]], before[key][[0, 2]]), key
    fresh = after["subgoal_history"][1]
    assert (fresh == after["subgoal"][1]).all()
    assert not torch.equal(after["subgoal"][1], before["subgoal"][1])
    stepped = env.step(steer(after, [0.0, 0.0]))["next"]
    assert torch.equal(stepped["subgoal_history"][1, 1:], fresh[:-1])
    assert torch.equal(stepped["subgoal_history"][0, 1:], before["subgoal_history"][0, :-1])


def test_a_reset_looks_at_the_images_of_the_scenes_that_are_reset_alone():
    env = make_env(3)
    grid, before = env.transform[0], env.reset()
    images = before.select(*grid.in_keys).clone()
    images["depth"][:] = 0.9  # a wall over all of the table
    images["segmentation"][:] = int(Label.OBSTACLE)
    mask = torch.tensor([[False], [True], [False]])
    after = grid._reset(TensorDict({"_reset": mask}, [3]), images.clone())
    assert after["occupancy"][1].float().mean() > 0.6
    for key in ("occupancy", "blocked_bits"):
        assert torch.equal(after[key][[0, 2]], before[key][[0, 2]]), key
    every = grid._reset(TensorDict({}, [3]), images)
    assert torch.equal(every["occupancy"], after["occupancy"][[1, 1, 1]])


def test_automatic_resets_begin_new_histories():
    # Pushed sideways, an episode ends after 14 steps or fewer; histories must not cross over.
    env = make_env(2)
    rollout = env.rollout(40, lambda td: steer(td, [0.0, 0.8]), break_when_any_done=False)
    ended = rollout["next", "done"][..., 0]
    assert ended.any(1).all()
    for scene in range(2):
        for t in range(39):
            history, then = (
                rollout["subgoal_history"][scene, t],
                rollout["subgoal_history"][scene, t + 1],
            )
            if ended[scene, t]:
                assert (then == rollout["subgoal"][scene, t + 1]).all()
            else:
                assert torch.equal(then[1:], history[:-1])


class Fickle(Planner):
    """Finds a path only while the start is in the image's lower half."""

    def plan(self, occupancy, start, goal):
        lines = [
            torch.stack([a, b]) if a[1] > 40 else None for a, b in zip(start, goal, strict=True)
        ]
        return Paths.from_waypoints(lines, start, self.cell_size)


def test_without_a_path_the_last_one_is_kept_and_flagged():
    env = make_env(1, planner=Fickle(), max_waypoints=4)
    tensordict = env.reset()
    assert tensordict["path_found"].all()
    kept = None
    for _ in range(12):
        tensordict = env.step(steer(tensordict, [1.0, 0.0]))["next"]
        if tensordict["path_found"].item():
            kept = tensordict["path_length"].clone(), tensordict["subgoal"].clone()
    assert kept is not None
    assert not tensordict["path_found"].item()
    assert torch.equal(tensordict["path_length"], kept[0])
    assert torch.equal(tensordict["subgoal"], kept[1])
    assert tensordict["path"].isfinite().all()


class NoPath(Planner):
    def plan(self, occupancy, start, goal):
        return Paths.from_waypoints([None] * len(start), start, self.cell_size)


def test_a_reset_without_a_path_points_straight_at_the_goal():
    tensordict = make_env(2, planner=NoPath()).reset()
    assert not tensordict["path_found"].any()
    assert torch.equal(tensordict["subgoal"], tensordict["goal_position"])
    away = tensordict["goal_position"] - tensordict["object_pose"][:, :2]
    torch.testing.assert_close(tensordict["path_length"], away.norm(dim=-1, keepdim=True))


def straight_and_bent():
    return Paths.from_waypoints(
        [torch.tensor([[0.0, 0.0], [30.0, 0.0], [30.0, 20.0]])], torch.zeros(1, 2)
    )


def test_sub_goals_by_hand():
    # 50 px in all: 20 % is 10 px along the first leg, 80 % is 10 px up the second one.
    assert fraction_subgoal(straight_and_bent(), 0.2).tolist() == [[10.0, 0.0]]
    assert fraction_subgoal(straight_and_bent(), 0.8).tolist() == [[30.0, 10.0]]
    assert lookahead_subgoal(straight_and_bent(), 12.0).tolist() == [[12.0, 0.0]]
    assert lookahead_subgoal(straight_and_bent(), 40.0).tolist() == [[30.0, 0.0]]


def test_sub_goals_do_not_depend_on_the_longest_path_of_the_batch():
    # The others are padded to it. Torch's own sum would add in another order.
    generator = torch.Generator().manual_seed(0)
    short = [200 * torch.rand(6, 2, generator=generator) for _ in range(200)]
    for count in (14, 32, 62):
        long = 200 * torch.rand(count, 2, generator=generator)
        alone = fraction_subgoal(Paths.from_waypoints(short, torch.zeros(200, 2)), 0.9)
        beside = fraction_subgoal(Paths.from_waypoints([*short, long], torch.zeros(201, 2)), 0.9)
        assert torch.equal(alone, beside[:200])


def test_points_ahead_by_hand():
    # Beyond the corner after 30 px, and not past the end after 50 px.
    found = points_ahead(straight_and_bent(), (10.0, 35.0, 60.0))
    assert found.tolist() == [[[10.0, 0.0], [30.0, 5.0], [30.0, 20.0]]]
    with pytest.raises(ValueError, match="distances must be finite and >= 0, got"):
        points_ahead(straight_and_bent(), (-1.0,))
    assert points_ahead(straight_and_bent(), ()).shape == (1, 0, 2)


def test_points_ahead_are_written_and_kept_where_there_is_no_path():
    env = make_env(2, mode="lookahead", ahead=(0.05, 9.0))
    check_env_specs(env)
    tensordict = env.reset()
    assert tensordict["path_ahead"].shape == (2, 2, 2)
    torch.testing.assert_close(
        tensordict["path_ahead"][:, 1], tensordict["goal_position"], atol=1e-5, rtol=0
    )
    near = (tensordict["path_ahead"][:, 0] - tensordict["object_pose"][:, :2]).norm(dim=-1)
    assert (near < 0.05 + 1e-6).all()
    lost = PlannerSubgoals(NoPath(), camera=SMALL, ahead=(0.05, 9.0))
    kept = lost._step(tensordict, tensordict.exclude("path_ahead"))["path_ahead"]
    assert torch.equal(kept, tensordict["path_ahead"])
    start = make_env(2, planner=NoPath(), ahead=(0.05, 9.0)).reset()
    assert (start["path_ahead"] == start["goal_position"].unsqueeze(-2)).all()


def test_the_leg_out_of_an_obstacle_is_not_the_first_segment():
    moved = Paths(**{**vars(straight_and_bent()), "start_moved": torch.tensor([True])})
    assert lookahead_subgoal(moved, 40.0).tolist() == [[30.0, 10.0]]


def test_a_path_is_padded_or_thinned_to_its_room():
    env = make_env(1, max_waypoints=2)
    tensordict = env.reset()
    ends = tensordict["path"][0]
    torch.testing.assert_close(ends[0], tensordict["object_pose"][0, :2], atol=1e-5, rtol=0)
    torch.testing.assert_close(ends[1], tensordict["goal_position"][0], atol=1e-5, rtol=0)
    many = make_env(1, max_waypoints=30).reset()["path"][0]
    torch.testing.assert_close(many[0], ends[0])
    assert (many[-5:] == many[-1]).all()
    legs = (many[1:] - many[:-1]).norm(dim=-1).sum()
    torch.testing.assert_close(legs, tensordict["path_length"][0, 0], atol=1e-5, rtol=0)


def test_keys_can_be_renamed_and_nested():
    env = TransformedEnv(
        TableEnv(2),
        Compose(
            RenameTransform(
                ["depth", "segmentation", "object_pose", "goal_position"],
                [("eye", "depth"), ("eye", "seg"), ("state", "pose"), ("task", "goal")],
            ),
            OccupancyGrid(
                camera=SMALL,
                depth_key=("eye", "depth"),
                segmentation_key=("eye", "seg"),
                occupancy_key=("map", "occupancy"),
                blocked_key=("map", "bits"),
            ),
            PlannerSubgoals(
                DistanceField(),
                camera=SMALL,
                max_waypoints=5,
                ahead=(0.1,),
                occupancy_key=("map", "occupancy"),
                object_pose_key=("state", "pose"),
                goal_position_key=("task", "goal"),
                path_length_key=("way", "length"),
                subgoal_key=("way", "subgoal"),
                subgoal_past_key=("way", "past"),
                path_found_key=("way", "found"),
                history_key=("way", "history"),
                path_ahead_key=("way", "ahead"),
                path_key=("way", "path"),
            ),
        ),
    )
    out, expected = env.reset(), make_env(2).reset()  # each env's first episode
    torch.testing.assert_close(out["way", "subgoal"], expected["subgoal"])
    check_env_specs(env)


def test_missing_keys_and_wrong_sizes_are_named():
    with pytest.raises(KeyError, match="'depth' is missing; there are \\['goal_position'\\]"):
        OccupancyGrid()(TensorDict(goal_position=torch.zeros(1, 2), batch_size=[1]))
    with pytest.raises(KeyError, match="'occupancy' is missing; there are \\['goal_position'\\]"):
        PlannerSubgoals(LazyThetaStar())(
            TensorDict(goal_position=torch.zeros(1, 2), batch_size=[1])
        )
    data = TableEnv(1).reset()
    OccupancyGrid(camera=SMALL)(data)
    with pytest.raises(ValueError, match=r"must be \[..., 1, 256, 256\], got \[1, 1, 64, 64\]"):
        PlannerSubgoals(LazyThetaStar())(data)
    with pytest.raises(ValueError, match=r"OccupancyGrid: object_radius: .*finite number, got nan"):
        OccupancyGrid(math.nan)


def test_nothing_is_rebuilt_while_obstacles_stand_still():
    env, field = make_env(2, planner=(planner := DistanceField())), planner
    env.rollout(12, lambda td: steer(td, [0.2, 0.6]), break_when_any_done=False)
    assert env.transform[0].map.inflations == 2
    assert field.builds <= 2


@pytest.mark.parametrize("with_next", [True, False])
def test_stored_data_are_rewritten_in_root_and_next(with_next):
    env = make_env(2)
    rollout = env.rollout(8, lambda td: steer(td, [0.1, 0.5]), break_when_any_done=False)
    stored = rollout.reshape(-1)
    changed = stored.clone()
    for data in (changed, changed["next"]):
        for key in ["occupancy", "path_length", "subgoal", "subgoal_past", "path_found"]:
            data[key] = torch.zeros_like(data[key])
    transform = Compose(OccupancyGrid(camera=SMALL), PlannerSubgoals(LazyThetaStar(), camera=SMALL))
    buffer = ReplayBuffer(storage=LazyTensorStorage(64), batch_size=16, transform=transform)
    changed = changed if with_next else changed.exclude("next")
    buffer.extend(changed.set("row", torch.arange(len(stored))))
    sample = buffer.sample()
    for key in [*WRITTEN, "occupancy", "blocked_bits"]:
        torch.testing.assert_close(sample[key], stored[key][sample["row"]])
        if with_next:
            torch.testing.assert_close(sample["next", key], stored["next", key][sample["row"]])


def test_a_next_that_cannot_be_rewritten_is_refused():
    stored = make_env(2).rollout(3, break_when_any_done=False).reshape(-1)
    with pytest.raises(KeyError, match=r"\['depth'\] are missing in 'next', so"):
        OccupancyGrid(camera=SMALL)(stored.clone().exclude(("next", "depth")))
    with pytest.raises(KeyError, match=r"\['occupancy'\] are missing in 'next'"):
        PlannerSubgoals(LazyThetaStar(), camera=SMALL)(stored.exclude(("next", "occupancy")))


def test_an_environment_that_lacks_a_key_is_refused_at_once():
    grid = OccupancyGrid(camera=SMALL, depth_key="range")
    with pytest.raises(KeyError, match=r"the environment does not emit \['range'\]"):
        check_env_specs(TransformedEnv(TableEnv(2), grid))
    with pytest.raises(KeyError, match=r"the environment does not emit"):
        check_env_specs(TransformedEnv(TableEnv(2), PlannerSubgoals("a_star", camera=SMALL)))


def test_inflation_by_name_or_by_metres():
    data = TableEnv(2).reset()

    def cells(**options):
        return OccupancyGrid(camera=SMALL, **options)(data.clone())["occupancy"]

    assert torch.equal(cells(), cells(inflation=0.025 * math.sqrt(2.0)))
    assert torch.equal(cells(inflation="inscribed"), cells(inflation=0.025))
    assert torch.equal(cells(object_radius=0.05), cells(inflation=0.05))
    assert torch.equal(
        cells(inscribed_radius=0.05, inflation="inscribed"), cells(object_radius=0.05)
    )
    assert cells(inflation="inscribed").sum() < cells().sum()


def test_lengths_are_in_metres_whatever_the_planner_counts_in():
    data = OccupancyGrid(camera=SMALL)(TableEnv(2).reset())
    lengths = [
        PlannerSubgoals(planner, camera=SMALL)(data.clone())["path_length"]
        for planner in (LazyThetaStar(), LazyThetaStar(cell_size=0.5), Straight())
    ]
    torch.testing.assert_close(lengths[1], lengths[0])
    away = data["goal_position"] - data["object_pose"][:, :2]  # `Straight` says nothing: pixels
    torch.testing.assert_close(lengths[2], away.norm(dim=-1, keepdim=True))
    looks = PlannerSubgoals(LazyThetaStar(), camera=SMALL, mode="lookahead", lookahead=0.03)
    ahead = looks(data.clone())["subgoal"] - data["object_pose"][:, :2]  # before any corner
    torch.testing.assert_close(ahead.norm(dim=-1), torch.full((2,), 0.03), atol=1e-5, rtol=0)


def gap_seen(gap: float) -> TensorDict:
    """An object before a wall with a gap, and its goal behind it, in the default camera's image."""
    walls = [(0.47, 0.53, -0.6, -gap / 2, 0.06), (0.47, 0.53, gap / 2, 0.6, 0.06)]
    boxes = [*((wall, Label.OBSTACLE) for wall in walls), (square(0.35, 0.0), Label.OBJECT)]
    depth, segmentation = (torch.from_numpy(image)[None, None] for image in render(boxes, CAMERA))
    poses = {"object_pose": torch.tensor([[0.35, 0.0, 0.0]]), "goal_position": [[0.65, 0.0]]}
    return TensorDict({"depth": depth, "segmentation": segmentation, **poses}, [1])


def test_a_path_that_closes_is_searched_again(monkeypatch):
    """And only then: while the cells stay what they were, there is nothing to look for."""
    searched = []
    monkeypatch.setattr(
        occupancy, "are_connected", lambda *given: searched.append(1) or are_connected(*given)
    )
    grid = OccupancyGrid(inflation="widest")
    td, choices = grid(gap_seen(0.09)), []
    for gap in (0.09, 0.064, 0.064, 0.09):
        searched.clear()
        td = grid._step(td, gap_seen(gap))
        choices.append((td["map_choice"].item(), len(searched)))
    # The gap of 9 cm lets the circumscribed circle of 7 cm through, that of 6.4 cm the inscribed one;
    # what was chosen stays until the episode's end.
    assert choices == [(0, 0), (1, 1), (1, 0), (1, 0)]


@pytest.mark.parametrize(
    ("inflation", "gap", "radius"),
    [
        ("widest", 0.12, 0.025 * math.sqrt(2.0) + 0.015),  # 10 cm are needed
        ("widest", 0.09, 0.025 * math.sqrt(2.0)),
        ("widest", 0.064, 0.025),
        (0.03, 0.12, 0.045),
        (0.03, 0.08, 0.03),
    ],
)
def test_a_clearance_is_kept_where_it_leaves_a_path(inflation, gap, radius):
    td = OccupancyGrid(inflation=inflation, clearance=0.015)(gap_seen(gap))
    expected = OccupancyGrid(inflation=radius)(gap_seen(gap))
    assert torch.equal(td["occupancy"], expected["occupancy"])


def two_bars(gap: float) -> Scenario:
    """Object and goal on both sides of a wall with a gap, which leaves no other way."""
    bars = [Obstacle((0.5, 0.06, 0.06), (0.5, y * (gap / 2 + 0.25), math.pi / 2)) for y in (-1, 1)]
    return Scenario(
        scene="free",
        difficulty=0.0,
        obstacles=tuple(bars),
        pushed_object="small_cube",
        object_pose=(0.35, 0.0, 0.0),
        goal_position=(0.65, 0.0),
        tool_pose=(0.35, 0.2, 0.0),
        dynamics=Dynamics(),
    )


@pytest.fixture(scope="module")
def widest_env():
    keys = {"object_radius_key": "object_radius", "inscribed_radius_key": "object_inscribed_radius"}
    env = TransformedEnv(
        PushEnv(3, max_episode_steps=4, seed=0),
        Compose(OccupancyGrid(inflation="widest", **keys), PlannerSubgoals(DistanceField())),
    )
    yield env
    env.close()


def test_the_widest_map_that_leaves_a_way_is_taken(widest_env):
    td = widest_env.reset(scenarios=[two_bars(gap) for gap in (0.09, 0.064, 0.03)])
    assert td["map_choice"].flatten().tolist() == [0, 1, 1]
    assert td["path_found"].flatten().tolist() == [True, True, False]
    for row, name in enumerate(("circumscribed", "inscribed", "inscribed")):
        expected = OccupancyGrid(inflation=name)(td.clone())["occupancy"]
        assert torch.equal(td["occupancy"][row], expected[row])


def test_a_map_stays_narrow_until_its_episode_ends(widest_env):
    td = widest_env.reset(scenarios=[two_bars(gap) for gap in (0.09, 0.064, 0.064)])
    td["action"] = torch.zeros(3, 3)
    td = widest_env.step(td)["next"]
    assert td["map_choice"].flatten().tolist() == [0, 1, 1]
    td["_reset"] = torch.tensor([[False], [True], [False]])
    td = widest_env.reset(td, scenarios=[two_bars(0.09)])
    assert td["map_choice"].flatten().tolist() == [0, 0, 1]
    assert td["path_found"].all()


def wall(half_length: float) -> Scenario:
    """Object and goal on both sides of a bar along y, in the middle of the workspace."""
    bar = Obstacle((2 * half_length, 0.06, 0.06), (0.5, 0.0, math.pi / 2))
    return replace(two_bars(0.09), obstacles=(bar,))


@pytest.fixture(scope="module")
def margins_env():
    env = TransformedEnv(
        PushEnv(3, max_episode_steps=4, seed=0),
        Compose(
            OccupancyGrid(bounds=WORKSPACE, margin=MARGINS),
            PlannerSubgoals(DistanceField()),
        ),
    )
    yield env
    env.close()


WORKSPACE, MARGINS = ((0.2, -0.35), (0.75, 0.35)), (0.0, -0.05)
LENGTHS = (0.20, 0.33, 0.38)  # ways inside, up to 5 cm outside, and none


def test_the_first_margin_that_leaves_a_way_counts(margins_env):
    td = margins_env.reset(scenarios=[wall(length) for length in LENGTHS])
    assert td["map_choice"].flatten().tolist() == [0, 1, 1]
    assert td["path_found"].flatten().tolist() == [True, True, False]
    for row, margin in enumerate((0.0, -0.05, -0.05)):
        expected = OccupancyGrid(bounds=WORKSPACE, margin=margin)(td.clone())["occupancy"]
        assert torch.equal(td["occupancy"][row], expected[row])
    td["action"] = torch.zeros(3, 3)
    assert margins_env.step(td)["next", "map_choice"].flatten().tolist() == [0, 1, 1]


def test_each_radius_is_tried_with_all_margins():
    grid = OccupancyGrid(bounds=WORKSPACE, margin=MARGINS, inflation="widest")
    env = TransformedEnv(PushEnv(3, seed=0), grid)
    td = env.reset(scenarios=[wall(0.20), wall(0.33), two_bars(0.064)])
    assert td["map_choice"].flatten().tolist() == [0, 1, 2]
    env.close()


def test_the_inflation_does_not_change_what_counts_as_the_object():
    data = TableEnv(2).reset()
    data.pop("segmentation")
    options = {"camera": SMALL, "segmentation_key": None}
    out = OccupancyGrid(inflation=0.0, **options)(data.clone())
    own = OccupancyGrid(**options)(data)
    assert torch.equal(out["blocked_bits"], own["blocked_bits"])
    assert out["occupancy"].sum() < own["occupancy"].sum()


def test_cells_outside_the_workspace_can_block():
    data = TableEnv(1).reset()
    bounds = ((0.30, -0.20), (0.80, 0.20))
    free = OccupancyGrid(camera=SMALL)(data.clone())["occupancy"][0, 0]
    out = OccupancyGrid(camera=SMALL, bounds=bounds, margin=0.05)(data.clone())["occupancy"][0, 0]
    v, u = torch.meshgrid(torch.arange(64), torch.arange(64), indexing="ij")
    x, y = SMALL.unproject(torch.stack([u, v], -1).double()).unbind(-1)
    inside = (x >= 0.35) & (x <= 0.75) & (y.abs() <= 0.15)
    assert inside.any()
    assert torch.equal(out[inside], free[inside])
    assert out[~inside].all()
    # The bar reaches 15 cm to either side: there is no way around it inside.
    planner = PlannerSubgoals(LazyThetaStar(), camera=SMALL)
    narrow = Compose(OccupancyGrid(camera=SMALL, bounds=bounds, margin=0.05), planner)
    wide = Compose(OccupancyGrid(camera=SMALL), planner)
    assert wide(data.clone())["path_found"].item()
    assert not narrow(data.clone())["path_found"].item()
    for wrong in (((0.8, 0.2), (0.3, -0.2)), ((5.0, 5.0), (6.0, 6.0))):
        with pytest.raises(ValueError, match="bounds and margin must leave a cell"):
            OccupancyGrid(bounds=wrong)
    with pytest.raises(ValueError, match="OccupancyGrid: bounds"):
        OccupancyGrid(bounds=((0.0, 0.0, 0.0), (1.0, 1.0, 1.0)))


def test_a_pose_that_is_not_finite_is_named_where_a_way_is_looked_for(margins_env):
    td = margins_env.reset()
    td["object_pose"][0, 0] = math.nan
    grid = OccupancyGrid(bounds=((0.3, -0.4), (0.9, 0.4)), margin=(0.0, -0.04))
    with pytest.raises(ValueError, match="'object_pose' must be finite"):
        grid(td.select(*grid.in_keys))


def test_at_a_partial_reset_only_those_scenes_are_searched_for_a_way(margins_env, monkeypatch):
    searched = []

    def counting(blocked, start, end):
        searched.append(len(blocked))
        return are_connected(blocked, start, end)

    monkeypatch.setattr(occupancy, "are_connected", counting)
    td = margins_env.reset()
    before = td.clone()
    assert searched[0] == len(td)
    searched.clear()
    td["_reset"] = torch.zeros(len(td), 1, dtype=torch.bool)
    td["_reset"][1] = True
    after = margins_env.reset(td)
    assert searched[0] == 1
    for key in ("occupancy", "map_choice", "path_length"):
        assert torch.equal(after[key][0], before[key][0]), key


class Straight:
    """A planner that may exchange rows and columns, or ends, as somebody's own might."""

    def __init__(self, mistake=None):
        self.mistake = mistake

    def plan(self, occupancy, start, goal):
        ends = torch.stack([start, goal], 1)
        if self.mistake == "reversed":
            ends = ends.flip(1)
        if self.mistake == "exchanged":
            ends = ends.flip(2)
        scale = SMALL.cell_size if self.mistake == "metres" else 1.0
        return Paths.from_waypoints(list(ends), start, scale)


@pytest.mark.parametrize("mistake", ["reversed", "exchanged"])
def test_a_path_that_begins_elsewhere_is_refused(mistake):
    env = make_env(2, planner=Straight())
    assert env.reset()["path_found"].all()
    env = make_env(2, planner=Straight(mistake))
    with pytest.raises(ValueError, match=r"the path of scene 0 must begin at \(u, v\) = "):
        env.reset()


def test_a_length_that_is_not_that_of_the_waypoints_is_refused():
    """It would be taken for pixels and put into metres once more."""
    env = make_env(2, planner=Straight("metres"))
    with pytest.raises(
        ValueError, match=r"length of scene 0's path .* times the planner's cell_size 1"
    ):
        env.reset()
