"""Geometry: solids, rectangles, frames, angles and the camera, with right arguments."""

import math

import numpy as np
import torch

from modpush import geometry
from tests.malformed.target import NOT_FINITE, NOT_POSITIVE, UNKNOWN, Target


def targets() -> list[Target]:
    """All of them."""
    return [*_geometry()]


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
