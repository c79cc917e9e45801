"""Functions of tensors, planners and encoders, with right arguments."""

import math

import numpy as np
import torch

from modpush import encoders, geometry, planners
from modpush.agents import encode_images, quantile_huber, truncate_atoms
from modpush.evaluation import (
    bootstrap_interval,
    episode_metrics,
    paired_t_test,
    shortest_path,
)
from modpush.replay import cosine, negative_l2
from tests.malformed.target import BELOW_1, KEYS, NOT_FINITE, NOT_POSITIVE, UNKNOWN, Target
from tests.test_validation import SCENARIO

CAMERA = geometry.Camera(height=32, width=32)


def targets() -> list[Target]:
    """All of them."""
    return [*_geometry(), *_plans(), *_maps(), *_windows(), *_encoders(), *_numbers()]


def _geometry() -> list[Target]:
    solid = {"position": (0.0, 0.0, 0.0), "color": (0.5, 0.5, 0.5)}
    lengths = {"length": NOT_POSITIVE, "radius": NOT_POSITIVE, "height": NOT_POSITIVE}
    triangle = ((0.0, 0.0), (0.1, 0.0), (0.0, 0.1))
    outlines = [(), triangle[:2], triangle[::-1], ((0, 0), (1, 0), (math.nan, 1)), "abc"]
    return [
        Target(
            name="box",
            call=geometry.box,
            given=lambda: {"length": 0.1, "width": 0.1, "height": 0.1, **solid},
            bad={**lengths, "width": NOT_POSITIVE, "color": [(0.5, 0.5), (2.0, 0.0, 0.0)]},
        ),
        Target(
            name="cylinder",
            call=geometry.cylinder,
            given=lambda: {"radius": 0.1, "length": 0.1, **solid},
            bad=lengths,
        ),
        Target(
            name="capsule",
            call=geometry.capsule,
            given=lambda: {"radius": 0.1, "length": 0.1, **solid},
            bad=lengths,
        ),
        Target(
            name="prism",
            call=geometry.prism,
            given=lambda: {"outline": triangle, "height": 0.1, **solid},
            bad={**lengths, "outline": outlines},
        ),
        Target(
            name="Rectangle",
            call=geometry.Rectangle,
            given=lambda: {"low": (0.0, 0.0), "high": (1.0, 1.0)},
            bad={"low": [(2.0, 2.0), (0.0,)], "high": [(-1.0, 1.0), (math.inf, 1.0)]},
        ),
        Target(
            name="Rectangle.bounds",
            call=lambda margin: geometry.WORKSPACE.bounds(margin),
            given=lambda: {"margin": 0.1},
            bad={"margin": [-5.0, *NOT_FINITE]},
        ),
        Target(
            name="check_frame",
            call=lambda frame: geometry.check_frame("it", frame),
            given=lambda: {"frame": "base"},
            bad={"frame": UNKNOWN},
        ),
        Target(
            name="frame_yaw",
            call=geometry.frame_yaw,
            given=lambda: {
                "frame": "path",
                "object_pose": torch.zeros(4, 3),
                "subgoal": torch.ones(4, 2),
            },
            bad={
                "frame": UNKNOWN,
                "subgoal": [None, torch.ones(4, 1), "text"],
                "object_pose": [torch.zeros(4, 2), None, 3],
            },
            only=["subgoal", "object_pose"],
        ),
        Target(
            name="rotate",
            call=geometry.rotate,
            given=lambda: {"vectors": torch.ones(4, 2), "angle": torch.ones(4, 1)},
            bad={
                "vectors": [torch.ones(4, 3), torch.ones(4, 1), None, "text", np.ones((4, 2))],
                "angle": [torch.ones(5, 1), torch.ones(4, 2), None, "text"],
            },
            only=["vectors", "angle"],
        ),
        Target(
            name="wrap_angle",
            call=geometry.wrap_angle,
            given=lambda: {"angle": torch.ones(4)},
            bad={"angle": [None, "text", [1.0], 3, torch.ones(2, dtype=torch.complex64)]},
            only=["angle"],
        ),
        Target(
            name="Camera.project",
            call=lambda position, z: geometry.CAMERA.project(position, z),
            given=lambda: {"position": torch.ones(4, 2), "z": 0.1},
            bad={
                "position": [torch.ones(4, 1), "text", None, [0.1, 0.2]],
                "z": ["3", None, torch.ones(7)],
            },
            only=["position", "z"],
        ),
        Target(
            name="Camera.unproject",
            call=lambda pixel: geometry.CAMERA.unproject(pixel),
            given=lambda: {"pixel": torch.ones(4, 2)},
            bad={"pixel": [torch.ones(4, 1), "text", None, [0.1, 0.2]]},
            only=["pixel"],
        ),
        Target(
            name="centered",
            call=lambda parts: geometry.centered(*parts),
            given=lambda: {"parts": (geometry.box(0.1, 0.1, 0.1),)},
            bad={"parts": [(), (1,), ("box",), (None,)]},
            only=["parts"],
        ),
    ]


def _query() -> dict[str, torch.Tensor]:
    occupancy = torch.zeros(3, 16, 16, dtype=torch.bool)
    occupancy[:, 8, :12] = True
    goal = torch.tensor([[2.0, 14.0]]).repeat(3, 1)
    return {"occupancy": occupancy, "start": torch.full((3, 2), 2.0), "goal": goal}


def _plans() -> list[Target]:
    found = [
        Target(
            name=f"{name}.plan",
            call=lambda name=name, **query: planners.make_planner("it", name).plan(**query),
            given=_query,
            bad={
                "occupancy": [
                    torch.zeros(3, 5000, 2, dtype=torch.bool),
                    torch.zeros(3, 0, 16, dtype=torch.bool),
                    torch.zeros(3, 16, 16),
                    torch.zeros(3, 16, 16, dtype=torch.uint8),
                ],
                "start": [torch.zeros(3, 2, dtype=torch.int64), torch.zeros(0, 2)],
            },
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
        for kind in (planners.DistanceField, planners.ThetaStar, planners.StraightLine)
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
            call=lambda planner: planners.make_planner("it", planner),
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
        ),
        *_subgoals(),
        Target(
            name="shortest_path",
            call=shortest_path,
            given=lambda: {"scenario": SCENARIO, "planner": planners.AStar()},
            bad={"scenario": [None, "free", {}], "planner": ["a_star", 3]},
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
        *(
            Target(
                name=function.__name__,
                call=function,
                given=lambda: {"outline": torch.tensor([[1.0, 1], [-1, 1], [-1, -1], [1, -1]])},
                bad={"outline": [torch.zeros(0, 2), torch.zeros(4, 3), None, "text", [[1, 1]]]},
            )
            for function in (planners.circumscribed_radius, planners.inscribed_radius)
        ),
    ]


def _maps() -> list[Target]:
    depth = torch.full((3, 32, 32), CAMERA.z)
    depth[:, 3:6] -= 0.06
    blocked = torch.zeros(3, 16, 16, dtype=torch.bool)
    radii = [-1.0, *NOT_FINITE, torch.ones(2), torch.tensor([1.0, 2.0, math.nan]), "3", None]
    return [
        Target(
            name="inflate",
            call=planners.inflate,
            given=lambda: {"blocked": blocked.clone(), "radius": 2.0},
            bad={"radius": radii, "blocked": [blocked.float(), blocked.numpy()]},
        ),
        Target(
            name="OccupancyMap",
            call=planners.OccupancyMap,
            given=lambda: {"camera": CAMERA, "min_height": 0.013, "upright": True},
            bad={"min_height": [*NOT_POSITIVE, 5.0], "camera": [3, "camera", {}]},
        ),
        Target(
            name="OccupancyMap.__call__",
            call=planners.OccupancyMap(CAMERA),
            given=lambda: {
                "depth": depth.clone(),
                "radius": 0.03,
                "segmentation": torch.zeros(3, 32, 32, dtype=torch.uint8),
                "object_position": torch.full((3, 2), 0.6),
                "previous": torch.zeros(3, 32, 8, dtype=torch.uint8),
                "object_radius": 0.03,
            },
            bad={
                "depth": [depth * 1000, depth.double(), depth[:, :16], depth[0]],
                "radius": radii,
                "object_radius": radii[:-1],
                "object_position": [torch.full((3, 2), math.nan), torch.zeros(2, 2)],
                "previous": [torch.zeros(1, 32, 8, dtype=torch.uint8)],
            },
            only=["depth"],
        ),
        Target(
            name="OccupancyGrid",
            call=planners.OccupancyGrid,
            given=lambda: {
                "object_radius": 0.03,
                "inscribed_radius": 0.02,
                "inflation": 0.03,
                "bounds": ((0.2, -0.3), (0.7, 0.3)),
                "margin": 0.0,
                "camera": CAMERA,
                "min_height": 0.013,
                "upright": True,
                "depth_key": "depth",
                "occupancy_key": ("nested", "occupancy"),
            },
            bad={
                "object_radius": [-1.0, *NOT_FINITE],
                "inscribed_radius": [-1.0, *NOT_FINITE],
                "inflation": [-1.0, *NOT_FINITE, *UNKNOWN],
                "bounds": [((9.0, 9.0), (10.0, 10.0)), (1, 2), ((0, 0),), ((0, 0, 0), (1, 1, 1))],
                "margin": NOT_FINITE,
                "depth_key": KEYS,
                "occupancy_key": KEYS,
            },
        ),
        Target(
            name="PlannerSubgoals",
            call=planners.PlannerSubgoals,
            given=lambda: {
                "planner": "a_star",
                "camera": CAMERA,
                "mode": "fraction",
                "fraction": 0.2,
                "lookahead": 0.2,
                "lags": (1, 5),
                "max_waypoints": 0,
                "path_key": "path",
            },
            bad={
                "planner": [*UNKNOWN, 3, object()],
                "mode": UNKNOWN,
                "fraction": [*NOT_POSITIVE, 1.5],
                "lookahead": NOT_POSITIVE,
                "lags": [(), (-1,), (1.5,), "15", 3],
                "max_waypoints": [-1, 1],
                "path_key": KEYS,
            },
        ),
    ]


def _windows() -> list[Target]:
    depth = torch.full((3, 32, 32), CAMERA.z)
    depth[:, 3:6] -= 0.06
    options = {"size": BELOW_1, "max_height": [*NOT_POSITIVE, 2.0], "outside": UNKNOWN}

    def window() -> dict[str, object]:
        return {
            "depth": depth.clone(),
            "segmentation": torch.zeros(3, 32, 32, dtype=torch.uint8),
            "pose": torch.tensor([[0.6, 0.0, 0.3]]).repeat(3, 1),
            "size": 16,
            "max_height": 0.08,
            "outside": "free",
            "upright": True,
            "camera": CAMERA,
        }

    return [
        Target(
            name="egocentric_window",
            call=encoders.egocentric_window,
            given=window,
            bad={**options, "depth": [depth * 1000, depth.double(), depth[0]]},
            only=["depth"],
        ),
        Target(
            name="window_pixels",
            call=encoders.window_pixels,
            given=lambda: {"pose": torch.zeros(2, 3), "size": 16, "height": 0.0, "camera": CAMERA},
            bad={
                "size": BELOW_1,
                "pose": [torch.zeros(2, 2), None, "text", [0.0, 0.0, 0.0], 3],
                "height": [*NOT_FINITE, 2.0],
            },
            only=["pose"],
        ),
        Target(
            name="cast_window",
            call=encoders.cast_window,
            given=lambda: {
                "cast": lambda pixels: (
                    np.full(len(pixels), 1.1, np.float32),
                    np.zeros(len(pixels), np.uint8),
                ),
                "pose": torch.tensor([0.6, 0.0, 0.3]),
                "size": 16,
                "max_height": 0.08,
                "outside": "free",
            },
            bad={
                **options,
                "cast": [None, 3, "cast"],
                "pose": [torch.zeros(2), torch.full((3,), math.nan), None, "text"],
            },
            only=["pose", "cast"],
        ),
        Target(
            name="EgocentricWindow",
            call=encoders.EgocentricWindow,
            given=lambda: {
                "frame": "path",
                "size": 16,
                "outside": "free",
                "max_height": 0.08,
                "upright": True,
                "camera": CAMERA,
                "depth_key": "depth",
                "window_key": ("nested", "window"),
            },
            bad={**options, "frame": UNKNOWN, "depth_key": KEYS, "window_key": KEYS},
        ),
    ]


def _encoders() -> list[Target]:
    from tests.malformed.networks import encoder_targets

    return encoder_targets()


def _numbers() -> list[Target]:
    flags = np.array([True, False])
    metrics = {
        "object_position": np.zeros((3, 2)),
        "goal_position": np.ones(2),
        "reward": np.zeros(2),
        "object_contact": flags,
        "object_contact_at_end": flags,
        "obstacle_contact": flags,
        "tool_obstacle_contact": flags,
        "success": True,
        "out_of_bounds": False,
        "shortest_length": 1.0,
        "authors_agent_length": 1.0,
        "authors_controller_length": 1.0,
    }
    pair = {"candidates": torch.rand(2, 5, 3), "queries": torch.rand(2, 3)}
    return [
        Target(
            name="truncate_atoms",
            call=truncate_atoms,
            given=lambda: {"atoms": torch.rand(2, 4, 5), "num_dropped": 2},
            bad={"num_dropped": [10, 100, -1], "atoms": [None, "text", torch.tensor(1.0)]},
            only=["atoms"],
        ),
        Target(
            name="quantile_huber",
            call=quantile_huber,
            given=lambda: {"quantiles": torch.rand(2, 4, 5), "targets": torch.rand(4, 6)},
            bad={
                "quantiles": [None, torch.rand(2, 3, 5), torch.rand(2, 4, 5).double(), "text"],
                "targets": [None, torch.rand(3, 6), torch.rand(4, 6).double(), torch.rand(6)],
            },
            only=["quantiles", "targets"],
        ),
        *(
            Target(
                name=function.__name__,
                call=function,
                given=lambda: {key: value.clone() for key, value in pair.items()},
                bad={
                    "candidates": [torch.rand(2, 5, 4), torch.rand(3), None, "text"],
                    "queries": [torch.rand(2, 4), torch.rand(3, 3), None, "text"],
                },
                only=["candidates", "queries"],
            )
            for function in (cosine, negative_l2)
        ),
        Target(
            name="encode_images",
            call=encode_images,
            given=lambda: {"encoder": encoders.RayScan(), "images": torch.rand(2, 1, 64, 64)},
            bad={"images": [torch.ones(2, 1, 64, 64, dtype=torch.int64), None, torch.rand(64)]},
            only=["images", "encoder"],
        ),
        Target(
            name="bootstrap_interval",
            call=bootstrap_interval,
            given=lambda: {
                "values": np.arange(5.0),
                "confidence": 0.9,
                "resamples": 20,
                "seed": 0,
            },
            bad={
                "values": ["text", np.ones((2, 2)), [1.0, math.nan], 3, None],
                "confidence": [0.0, 1.0, *NOT_FINITE],
                "resamples": BELOW_1,
                "seed": [-1],
            },
            only=["values"],
        ),
        Target(
            name="paired_t_test",
            call=paired_t_test,
            given=lambda: {"first": np.arange(5.0), "second": np.ones(5)},
            bad={
                "first": ["text", np.ones(4), np.ones((2, 2)), [1.0, math.nan, 1, 1, 1], None],
                "second": ["text", np.ones(4), np.ones((2, 2)), [1.0, math.nan, 1, 1, 1], None],
            },
            only=["first", "second"],
        ),
        Target(
            name="episode_metrics",
            call=episode_metrics,
            given=lambda: dict(metrics),
            bad={
                "object_position": [np.zeros((2, 2)), np.zeros((3, 3)), np.full((3, 2), math.nan)],
                "goal_position": [np.ones(3), np.full(2, math.nan), None],
                "reward": [np.zeros(3), np.full(2, math.nan)],
                "object_contact": [flags[:1], None, "text"],
                "shortest_length": NOT_POSITIVE,
            },
            only=["object_position", "goal_position", "reward", "object_contact"],
        ),
    ]
