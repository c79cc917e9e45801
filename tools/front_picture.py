"""Draw the moving picture of README: the shipped agent pushes four objects through clutter.

    python tools/front_picture.py            # writes docs/pictures/pushing.webp
    python tools/front_picture.py --still    # and its middle frame beside it, as a PNG

Arm, objects and obstacles are the shapes that physics uses, drawn here with a depth buffer, so that
neither a renderer nor a GPU is needed.
"""

import argparse
import math
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import cv2
import imageio.v3 as imageio
import numpy as np
import torch
from numpy.typing import NDArray
from torchrl.envs import step_mdp

from modpush.envs import OBJECTS, PushEnv, Scenario
from modpush.envs.robot.named import ROBOTS, TOOLS
from modpush.geometry.shapes import Primitive, box
from modpush.recipes import get_method
from modpush.viewer.overlays import primitive_mesh

PICTURE = Path(__file__).resolve().parents[1] / "docs" / "pictures" / "pushing.webp"
EPISODES = (
    ("small_cube", "slot"),
    ("fragment", "zigzag"),
    ("small_cylinder", "corridor"),
    ("large_cube", "bar_across"),
)
"""Object and scene family of each of the four clips."""
DETOUR = 1.12  # least length of the planned path, as a multiple of the straight line
WIDTH, HEIGHT, SAMPLES = 400, 320, 2  # of a clip [px]; samples per pixel and axis
EYE, TARGET = np.array([1.30, -0.66, 0.80]), np.array([0.36, 0.04, 0.13])  # [m]
FOCAL = 1.22  # of the clip's height
LIGHT = np.array([0.25, -0.35, 0.90]) / np.linalg.norm([0.25, -0.35, 0.90])
TABLE, BACKGROUND = (0.96, 0.95, 0.93), (1.0, 1.0, 1.0)
GOAL, PATH, OBSTACLE = (0.99, 0.76, 0.22), (0.80, 0.15, 0.60), (0.36, 0.40, 0.47)
HOLD = 12  # frames after the last clip has ended

Vertices = NDArray[np.float64]


class Body(NamedTuple):
    """Triangles of one colour, in the robot's base frame."""

    triangles: Vertices
    """`[n, 3, 3]` [m]."""
    color: tuple[float, float, float]


class Moment(NamedTuple):
    """A step of an episode."""

    joint_position: Vertices
    object_pose: Vertices
    path: Vertices
    """Planned path of the object, `[n, 2]` [m]."""


def straight_distance(scenario: Scenario) -> float:
    """Distance from start to goal [m]."""
    return math.dist(scenario.object_pose[:2], scenario.goal_position)


@torch.no_grad()
def run_episode(pushed_object: str, scene: str) -> tuple[Scenario, list[Moment]]:
    """The first episode of the shipped agent whose path leads around an obstacle, until its end."""
    method = get_method("any_object")
    env = method.make_env(
        1, (pushed_object,), scene=scene, difficulty=0.4, distance=(0.4, 0.5), seed=0
    )
    simulator = env.base_env
    assert isinstance(simulator, PushEnv)
    policy, moments = method.make_policy(), []
    td = env.reset()
    while td["path_length"].item() < DETOUR * straight_distance(simulator.scenarios[0]):
        td = env.reset()
    done = False
    while not done:
        path = td[method.path_key][0].double().numpy()
        moments.append(
            Moment(
                td["joint_position"][0].double().numpy(),
                td["object_pose"][0].double().numpy(),
                path[np.isfinite(path).all(-1)],
            )
        )
        step = env.step(policy(td))
        td, done = step_mdp(step), step["next", "done"].item()
    success = step["next", "success"].item()
    print(f"{pushed_object}, {scene}: {len(moments)} steps, success {success}", flush=True)
    scenario = simulator.scenarios[0]
    env.close()
    return scenario, moments


def bodies_of(parts: Sequence[Primitive], transform: Vertices) -> Iterator[Body]:
    """The triangles of a body's parts."""
    for part in parts:
        mesh = primitive_mesh(part)
        placed = mesh.vertices @ transform[:3, :3].T + transform[:3, 3]
        yield Body(placed[mesh.faces], part.color)


def planar_transform(x: float, y: float, yaw: float, z: float) -> Vertices:
    """Transform of an upright body, `[4, 4]`."""
    cos, sin = math.cos(yaw), math.sin(yaw)
    return np.array([[cos, -sin, 0, x], [sin, cos, 0, y], [0, 0, 1, z], [0, 0, 0, 1.0]])


def all_bodies(scenario: Scenario, moment: Moment) -> list[Body]:
    """Arm, tool, object and obstacles."""
    bodies: list[Body] = []
    robot = ROBOTS["ur5"]
    shapes = [*(link.shapes for link in robot.links), TOOLS["2f85"].shapes]
    transforms = robot.link_transforms(moment.joint_position)
    for parts, transform in zip(shapes, transforms, strict=True):
        bodies += bodies_of(parts, transform)
    pushed = OBJECTS[scenario.pushed_object]
    bodies += bodies_of(pushed.parts, planar_transform(*moment.object_pose, pushed.height / 2))
    for obstacle in scenario.obstacles:
        part = box(*obstacle.size, color=OBSTACLE)
        bodies += bodies_of([part], planar_transform(*obstacle.pose, obstacle.size[2] / 2))
    return bodies


class Camera:
    """A pinhole camera that looks from `EYE` to `TARGET`."""

    def __init__(self, width: int, height: int) -> None:
        ahead = (TARGET - EYE) / np.linalg.norm(TARGET - EYE)
        right = np.cross(ahead, [0.0, 0.0, 1.0])
        right /= np.linalg.norm(right)
        self.axes = np.stack([right, -np.cross(right, ahead), ahead])
        self.scale, self.centre = FOCAL * height, np.array([width / 2, height / 2])

    def project(self, points: Vertices) -> Vertices:
        """Column and row [px] and depth [m] of points, `[..., 3]`."""
        seen = (points - EYE) @ self.axes.T
        return np.concatenate(
            [seen[..., :2] / seen[..., 2:] * self.scale + self.centre, seen[..., 2:]], -1
        )

    def polygon(self, points: Vertices) -> NDArray[np.int32]:
        """Points `[n, 3]` as integers with four binary digits, for OpenCV's `shift=4`."""
        return np.round(self.project(points)[..., :2] * 16).astype(np.int32)


def draw(scenario: Scenario, moment: Moment) -> NDArray[np.uint8]:
    """The picture of a step, `[HEIGHT, WIDTH, 3]`."""
    width, height = WIDTH * SAMPLES, HEIGHT * SAMPLES
    camera = Camera(width, height)
    image = np.full((height, width, 3), BACKGROUND, np.float32)
    table = np.array([[-0.5, -0.8, 0], [1.1, -0.8, 0], [1.1, 0.9, 0], [-0.5, 0.9, 0]])
    cv2.fillConvexPoly(image, camera.polygon(table), TABLE, cv2.LINE_AA, 4)
    _draw_on_table(image, camera, scenario, moment)
    bodies = all_bodies(scenario, moment)
    triangles = np.concatenate([body.triangles for body in bodies])
    colors = np.concatenate([np.tile(b.color, (len(b.triangles), 1)) for b in bodies])
    shadow = np.zeros((height, width), np.float32)
    fallen = triangles - triangles[..., 2:] / LIGHT[2] * LIGHT
    for polygon in camera.polygon(fallen):
        cv2.fillConvexPoly(shadow, polygon, 1.0, cv2.LINE_8, 4)
    image *= 1 - 0.28 * cv2.GaussianBlur(shadow, (0, 0), 2.5 * SAMPLES)[..., None]
    _draw_triangles(image, camera, triangles, colors)
    small = cv2.resize(image, (WIDTH, HEIGHT), interpolation=cv2.INTER_AREA)
    return (np.clip(small, 0, 1) * 255).astype(np.uint8)


def _draw_on_table(
    image: NDArray[np.float32], camera: Camera, scenario: Scenario, moment: Moment
) -> None:
    angles = np.linspace(0, 2 * math.pi, 48, endpoint=False)
    circle = 0.05 * np.column_stack([np.cos(angles), np.sin(angles), 0 * angles])
    disc = circle + np.array([*scenario.goal_position, 0.0])
    cv2.fillConvexPoly(image, camera.polygon(disc), GOAL, cv2.LINE_AA, 4)
    path = np.column_stack([moment.path, np.zeros(len(moment.path))])
    if len(path) > 1:
        lines = [camera.polygon(path)]
        cv2.polylines(image, lines, False, PATH, 2 * SAMPLES, cv2.LINE_AA, 4)


def _draw_triangles(
    image: NDArray[np.float32], camera: Camera, triangles: Vertices, colors: Vertices
) -> None:
    """Draw triangles where nothing nearer has been drawn."""
    normals = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True) + 1e-12
    faces_camera = ((EYE - triangles[:, 0]) * normals).sum(-1) > 0
    light = (
        0.50
        + 0.42 * np.maximum(normals @ LIGHT, 0)
        + 0.10 * np.maximum(normals @ -camera.axes[2], 0)
    )
    shaded = (colors * light[:, None]).astype(np.float32)
    nearest = np.full(image.shape[:2], np.inf)
    for corners, color in zip(
        camera.project(triangles)[faces_camera], shaded[faces_camera], strict=True
    ):
        low = np.maximum(np.floor(corners[:, :2].min(0)).astype(int), 0)
        high = np.minimum(np.ceil(corners[:, :2].max(0)).astype(int) + 1, image.shape[1::-1])
        (ax, ay, _), (bx, by, _), (cx, cy, _) = corners
        area = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
        if (high <= low).any() or abs(area) < 1e-9:
            continue
        x = np.arange(low[0], high[0]) + 0.5
        y = np.arange(low[1], high[1])[:, None] + 0.5
        b = ((x - ax) * (cy - ay) - (y - ay) * (cx - ax)) / area
        c = ((bx - ax) * (y - ay) - (by - ay) * (x - ax)) / area
        inverse = (1 - b - c) / corners[0, 2] + b / corners[1, 2] + c / corners[2, 2]
        depth = 1 / np.maximum(inverse, 1e-9)
        here = np.s_[low[1] : high[1], low[0] : high[0]]
        seen = (b >= 0) & (c >= 0) & (b + c <= 1) & (depth < nearest[here])
        nearest[here][seen] = depth[seen]
        image[here][seen] = color


def main() -> None:
    """Run the four episodes and write the picture."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--still", action="store_true", help="write the middle frame as a PNG, too")
    options = parser.parse_args()
    clips = []
    for pushed_object, scene in EPISODES:
        scenario, moments = run_episode(pushed_object, scene)
        clips.append([draw(scenario, moment) for moment in moments])
    length = max(map(len, clips)) + HOLD
    padded = [clip + [clip[-1]] * (length - len(clip)) for clip in clips]
    frames = [
        np.vstack([np.hstack([a, b]), np.hstack([c, d])])
        for a, b, c, d in zip(*padded, strict=True)
    ]
    imageio.imwrite(PICTURE, np.stack(frames), duration=1000 / 15, loop=0, quality=75, method=6)
    print(f"Wrote {PICTURE}, {len(frames)} frames, {PICTURE.stat().st_size / 1e6:.2f} MB.")
    if options.still:
        imageio.imwrite(PICTURE.with_suffix(".png"), frames[len(frames) // 2])


if __name__ == "__main__":
    main()
