"""Occupancy grids and windows from depth images, with right arguments."""

import math

import numpy as np
import torch

from modpush import encoders, geometry, planners
from tests.malformed.target import BELOW_1, KEYS, NOT_FINITE, NOT_POSITIVE, UNKNOWN, Target

CAMERA = geometry.Camera(height=32, width=32)


def targets() -> list[Target]:
    """All of them."""
    return [*_maps(), *_windows()]


def _maps() -> list[Target]:
    depth = torch.full((2, 32, 32), CAMERA.z)
    depth[:, 3:6] -= 0.06
    blocked = torch.zeros(2, 16, 16, dtype=torch.bool)
    radii = [-1.0, *NOT_FINITE, torch.ones(3), torch.tensor([1.0, math.nan]), "3", None]
    return [
        Target(
            name="inflate",
            call=planners.inflate,
            given=lambda: {"blocked": blocked.clone(), "radius": 2.0},
            bad={
                "radius": radii,
                "blocked": [
                    blocked.float(),
                    blocked.numpy(),
                    blocked[0],
                    blocked[..., None],
                    blocked.to(torch.complex64),
                    torch.zeros(1, 5000, 2, dtype=torch.bool),
                    None,
                ],
            },
            only=["blocked"],
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
                "segmentation": torch.zeros(2, 32, 32, dtype=torch.uint8),
                "object_position": torch.full((2, 2), 0.6),
                "previous": torch.zeros(2, 32, 8, dtype=torch.uint8),
                "object_radius": 0.03,
            },
            bad={
                "depth": [depth * 1000, depth.double(), depth[:, :16], depth[0]],
                "radius": radii,
                "object_radius": radii[:-1],
                "object_position": [torch.full((2, 2), math.nan), torch.zeros(3, 2)],
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
