"""Plan the path of a pushed object on a depth image, without a simulator, in ten lines.

    python examples/plan_on_depth_png.py                       # makes its own small picture
    python examples/plan_on_depth_png.py --depth mine.png --start 60 200 --goal 190 40

Reads a 16-bit PNG of a camera that looks straight down on a table (depth in millimetres), finds
what stands on it, inflates that by the object's radius and plans the object's path around it.
Prints the path's length and writes a picture of it. Without `--depth` it first writes
`runs/depth.png`, a table with three bars, and plans on that.
"""

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import torch
import tyro

from modpush.geometry import Camera
from modpush.planners import LazyThetaStar, OccupancyMap


@dataclass
class Config:
    """The depth picture, start and goal."""

    depth: Path | None = None
    """16-bit PNG of depths in millimetres; an example is made by default."""
    start: tuple[float, float] = (60.0, 200.0)
    """Position of the object (column, row) [px]."""
    goal: tuple[float, float] = (190.0, 40.0)
    """Position of the goal (column, row) [px]."""
    camera_height: float = 1.1
    """Height of the camera over the table [m]."""
    object_radius: float = 0.035
    """Radius of the circle around the object's footprint [m]."""
    output: Path = Path("runs/plan_on_depth.png")
    """Picture to write."""


def make_depth(path: Path) -> Path:
    """Write a depth picture of a table, 1.1 m below the camera, with three bars 6 cm high."""
    depth = np.full((256, 256), 1100, dtype=np.uint16)
    for corner, size in (((20, 150), (130, 18)), ((110, 90), (18, 60)), ((110, 60), (110, 18))):
        (u, v), (width, height) = corner, size
        depth[v : v + height, u : u + width] = 1040
    path.parent.mkdir(parents=True, exist_ok=True)
    cv2.imwrite(str(path), depth)
    return path


def main(config: Config) -> float:
    """Plan, draw, and return the path's length [m]."""
    source = config.depth or make_depth(config.output.with_name("depth.png"))
    image = cv2.imread(str(source), cv2.IMREAD_UNCHANGED)
    if image is None or image.dtype != np.uint16 or image.ndim != 2:
        raise ValueError(f"plan_on_depth_png: {source} is not a 16-bit picture of one channel.")

    # These are the ten lines.
    depth = torch.from_numpy(image.astype(np.float32) / 1000)[None]  # [1, H, W], metres
    height, width = image.shape
    camera = Camera(height=height, width=width, z=config.camera_height)
    start, goal = torch.tensor([config.start, config.goal]).float()[:, None]
    occupancy, _ = OccupancyMap(camera)(
        depth, config.object_radius, object_position=camera.unproject(start)
    )
    paths = LazyThetaStar(cell_size=camera.cell_size).plan(occupancy, start, goal)
    waypoints, length = paths.waypoints[0, : paths.count[0]], paths.length.item()

    if paths.found:
        print(f"{length:.3f} m over {len(waypoints) - 2} corners, from {waypoints[0].tolist()}")
    else:
        print("no path found")
    picture = cv2.cvtColor(255 - 90 * occupancy[0].byte().numpy(), cv2.COLOR_GRAY2BGR)
    picture[image < 1000 * (config.camera_height - 0.013)] = (90, 90, 90)
    scaled = cv2.resize(picture, None, fx=3, fy=3, interpolation=cv2.INTER_NEAREST)
    line = ((waypoints + 0.5) * 3).round().int().numpy()
    cv2.polylines(scaled, [line], False, (200, 0, 200), 2, cv2.LINE_AA)
    for point, colour in ((config.start, (0, 0, 220)), (config.goal, (0, 160, 0))):
        centre = tuple(round((value + 0.5) * 3) for value in point)
        cv2.circle(scaled, centre, 8, colour, -1, cv2.LINE_AA)
    config.output.parent.mkdir(parents=True, exist_ok=True)
    cv2.imwrite(str(config.output), scaled)
    print(f"picture: {config.output}")
    return length


if __name__ == "__main__":
    main(tyro.cli(Config))
