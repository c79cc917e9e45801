"""Push from a depth image to an arm, as on a real robot; MuJoCo stands in for reality.

    python examples/deploy.py --episodes 100 --out runs/deploy

An agent, by name or a folder of `modpush export`, runs through `modpush.deploy`. It reads nothing but the
noisy image of a depth camera that is tilted by 30 degrees, and the angles of the arm's joints. Each
episode writes a line; at the end there is a table, in `report.md`, and a video of the first push in
`push.mp4`, the camera's image beside the view from above. A folder that has some of the episodes is
continued. What runs on a real arm is `push` with the same controller and guard: docs/howto/real_arm.md.
"""

import argparse
import math
import warnings
from collections.abc import Iterator
from pathlib import Path

import cv2
import imageio
import numpy as np
import pandas as pd
import torch
from numpy.typing import NDArray

from modpush.deploy import (
    Command,
    DepthImage,
    Guard,
    Perception,
    PushController,
    SimulatedRobot,
    Stopped,
    load_policy,
    push,
)
from modpush.envs import PushedObject, Scenario
from modpush.envs.depth.stereo_noise import stereo_noise
from modpush.envs.engines.mujoco.depth_renderer import DepthRenderer
from modpush.envs.scenes.drawing import draw_top_view
from modpush.evaluation import load_set
from modpush.geometry import CameraModel
from modpush.geometry.footprint import clearances

OBJECTS = ("small_cube", "large_cube", "small_cylinder", "fragment")
# One metre from the table's middle, beyond it as seen from the arm, 30 degrees from straight down.
CAMERA = CameraModel.looking_at(target=(0.5, 0.0, 0.0), position=(1.0, 0.0, 0.866))
LOST = 0.02, math.radians(20)  # errors from which the object counts as lost [m, rad]


class Recorder:
    """Compares what was seen with the truth, and keeps the pictures of a video."""

    def __init__(self, arm: SimulatedRobot, controller: PushController, pictures: bool) -> None:
        self.arm, self.controller, self.pictures = arm, controller, pictures
        self.renderer, self.rng = DepthRenderer(CAMERA), np.random.default_rng(0)
        self.exact = np.zeros(CAMERA.size[::-1], np.float32)
        self.top = points_on_top(arm.item)
        self.frames: list[NDArray[np.uint8]] = []
        self.errors: list[tuple[float, float, float, bool]] = []

    def read_depth(self) -> DepthImage:
        self.exact = self.renderer(self.arm.scene)
        return DepthImage(stereo_noise(self.exact, self.rng), self.arm.time)

    def __call__(self, image: DepthImage, command: Command | None) -> None:
        seen = self.controller.perceived
        assert seen is not None
        true, symmetry = self.arm.object_pose, self.arm.item.symmetry
        x, y, turn = np.array(seen.object.pose) - true
        period = 2 * math.pi / max(symmetry, 1)
        turn = 0.0 if symmetry == 0 else abs((turn + period / 2) % period - period / 2)
        self.errors.append((math.hypot(x, y), turn, self.hidden(true), seen.object.found))
        if self.pictures:
            self.frames.append(picture(image, self.arm.scenario, seen.object.pose, seen.tip_pose))

    def hidden(self, pose: NDArray[np.float64]) -> float:
        """Share of the object's top, where it truly is, that the exact image does not show."""
        x, y, yaw = pose
        turn = np.array([[math.cos(yaw), math.sin(yaw)], [-math.sin(yaw), math.cos(yaw)]])
        points = np.column_stack(
            [self.top @ turn + (x, y), np.full(len(self.top), self.arm.item.height)]
        )
        pixels, depth = CAMERA.project(points)
        u, v = np.rint(pixels).astype(int).T
        return float((self.exact[v, u] < depth - 0.005).mean())


def points_on_top(item: PushedObject) -> NDArray[np.float64]:
    """Points 2 mm apart within an object's outline, `[n, 2]` [m]."""
    side = np.arange(-item.radius, item.radius, 0.002)
    points = np.stack(np.meshgrid(side, side), -1).reshape(-1, 2)
    return points[np.any([(clearances(points, o) < 0).all(1) for o in item.footprints()], axis=0)]


def picture(image: DepthImage, scenario: Scenario, pose: tuple, tip: tuple) -> NDArray[np.uint8]:
    """The camera's image beside the view from above, with the object where it is believed to be."""
    above = draw_top_view(scenario, pose, tip)
    near, far = 0.6, 1.3
    grey = np.clip((far - image.depth) / (far - near), 0, 1) * (image.depth > 0) * 255
    side = cv2.applyColorMap(grey.astype(np.uint8), cv2.COLORMAP_BONE)[..., ::-1]
    width = above.shape[0] * side.shape[1] // side.shape[0] // 2 * 2
    return np.hstack([cv2.resize(side, (width, above.shape[0])), above])


def run_episode(agent: str, scenario: Scenario, video: Path | None, rate: float | None) -> dict:
    """One push, and a row of figures."""
    with_arm = SimulatedRobot(scenario, aside=True)
    controller = PushController(
        load_policy(agent), Perception(CAMERA, scenario.pushed_object), rate=rate
    )
    recorder = Recorder(with_arm, controller, video is not None)
    guard, why = Guard(with_arm, controller, CAMERA), ""
    with_arm.connect()
    try:
        push(
            guard,
            recorder.read_depth,
            scenario.goal_position,
            approach=with_arm.approach,
            on_step=recorder,
        )
    except Stopped as stopped:
        why = str(stopped)
    away = math.dist(with_arm.object_pose[:2], scenario.goal_position)
    with_arm.close()
    if video is not None:
        imageio.mimwrite(video, recorder.frames, fps=15, macro_block_size=2)
    distance, turn, hidden, found = np.array(recorder.errors).reshape(-1, 4).T
    clear = hidden < 0.3
    within = (distance <= 0.005) & (turn <= math.radians(5))
    lost = (distance > LOST[0]) | (turn > LOST[1])
    return {
        "scene": scenario.scene,
        "object": scenario.pushed_object,
        "success": not why and away <= 0.05,
        "stopped": why,
        "images": len(within),
        "clear": int(clear.sum()),
        "clear_within": int((within & clear).sum()),
        "within": int(within.sum()),
        "worst_clear_mm": float(distance[clear].max(initial=0) * 1e3),
        "worst_clear_deg": float(np.degrees(turn[clear].max(initial=0))),
        "lost_s": longest(lost) / controller.rate,
        "unconfirmed_s": longest(found == 0) / controller.rate,
    }


def longest(flags: NDArray[np.bool_]) -> int:
    """Length of the longest run of True."""
    run = best = 0
    for flag in flags.tolist():
        run = run + 1 if flag else 0
        best = max(best, run)
    return best


def table(rows: pd.DataFrame) -> str:
    """The figures by scene family, as Markdown."""
    names = ["scene", "episodes", "solved", "clear images", "of these within 5 mm and 5°"]
    names += ["all images within 5 mm and 5°", "longest loss [s]", "longest unconfirmed [s]"]
    lines = [f"| {' | '.join(names)} |", "|---" * len(names) + "|"]
    for name, part in [*rows.groupby("scene"), ("all", rows)]:
        clear, all_images = part.clear.sum(), part.images.sum()
        shares = f"{part.clear_within.sum() / clear:.1%} | {part.within.sum() / all_images:.1%}"
        counts = f"{len(part)} | {part.success.mean():.2f} | {clear}"
        lines.append(
            f"| {name} | {counts} | {shares} | {part.lost_s.max():.2f} | {part.unconfirmed_s.max():.2f} |"
        )
    return "\n".join(lines) + "\n"


def scenarios(count: int) -> Iterator[Scenario]:
    """Episodes of the evaluation sets: five families by turns, then four objects."""
    sets = [load_set(f"obstacles/{name}").scenarios for name in OBJECTS]
    return (sets[n // 5 % 4][n // 20 * 5 + n % 5] for n in range(count))


def main(agent: str, out: Path, episodes: int = 100, rate: float | None = None) -> pd.DataFrame:
    """Run the missing episodes, and write the table."""
    out.mkdir(parents=True, exist_ok=True)
    file = out / "episodes.csv"
    rows = pd.read_csv(file, keep_default_na=False).to_dict("records") if file.exists() else []
    for number, scenario in enumerate(scenarios(episodes)):
        if number < len(rows):
            continue
        rows.append(run_episode(agent, scenario, out / "push.mp4" if number == 0 else None, rate))
        print(number, *rows[-1].values(), sep="  ", flush=True)
        pd.DataFrame(rows).to_csv(file, index=False)
    found = pd.DataFrame(rows)
    (out / "report.md").write_text(table(found), encoding="utf-8")
    print(table(found))
    return found


if __name__ == "__main__":
    warnings.filterwarnings("ignore", message="Failed to find system libvulkan")
    torch.set_num_threads(1)
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument(
        "--agent", default="any_object", help="an agent, or a folder of modpush export"
    )
    parser.add_argument("--episodes", type=int, default=100, help="number of episodes")
    parser.add_argument(
        "--rate", type=float, help="control steps per second, if not the agent's 15"
    )
    parser.add_argument(
        "--out", type=Path, default=Path("runs/deploy"), help="folder of the results"
    )
    given = parser.parse_args()
    main(given.agent, given.out, given.episodes, given.rate)
