"""Push from a depth image to an arm, as on a real robot; MuJoCo stands in for reality.

    python examples/deploy.py --episodes 20 --out runs/deploy

An agent, by name or a folder of `modpush export`, runs through `modpush.deploy`. It reads nothing but the
noisy image of a depth camera that is tilted by 30 degrees, the angles of the arm's joints, and where a
person has put the object, to within 2 cm. At the end there is a table, in `report.md`, and a video of the
first push in `push.mp4`, the camera's image beside the view from above. A folder that has some of the
episodes is continued. What runs on a real arm is `push` with the same controller and guard:
docs/howto/real_arm.md.
"""

import argparse
import math
import warnings
from collections.abc import Iterable, Sequence
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from itertools import groupby
from multiprocessing import get_context
from pathlib import Path

import cv2
import imageio
import numpy as np
import pandas as pd
import torch
from numpy.typing import ArrayLike, NDArray

from modpush.deploy import (
    Command,
    DepthImage,
    Guard,
    Perception,
    PushController,
    SimulatedRobot,
    Stopped,
    push,
)
from modpush.envs import Scenario
from modpush.envs.depth.stereo_noise import stereo_noise
from modpush.envs.engines.mujoco.rendering import DepthRenderer
from modpush.envs.outcome import pose_errors
from modpush.envs.scenes.drawing import draw_top_view
from modpush.evaluation import load_set
from modpush.geometry import CameraModel

SETS = [f"obstacles/{name}" for name in ("small_cube", "large_cube", "small_cylinder", "fragment")]
# One metre from the table's middle, beyond it as seen from the arm, 30 degrees from straight down.
CAMERA = CameraModel.looking_at(target=(0.5, 0.0, 0.0), position=(1.0, 0.0, 0.866))
GUESS = 0.02  # error of where the person says that the object is [m]
LOST = 0.02, math.radians(20)  # errors from which the object counts as lost [m, rad]


class Recorder:
    """Compares what was seen with the truth, and keeps the pictures of a video."""

    def __init__(self, arm: SimulatedRobot, controller: PushController, pictures: bool) -> None:
        self.arm, self.controller, self.pictures = arm, controller, pictures
        self.renderer, self.rng = DepthRenderer(CAMERA), np.random.default_rng(0)
        self.exact = np.zeros(CAMERA.size[::-1], np.float32)
        self.frames: list[NDArray[np.uint8]] = []
        self.rows: list[tuple[float, float, float, bool]] = []

    def read_depth(self) -> DepthImage:
        self.exact = self.renderer(self.arm.scene)
        return DepthImage(stereo_noise(self.exact, self.rng), self.arm.time)

    def __call__(self, image: DepthImage, command: Command | None) -> None:
        seen, true = self.controller.perceived, self.arm.object_pose
        assert seen is not None
        distance, turn = self.error(seen.object.pose, true)
        perception = self.controller.perception
        assert isinstance(perception, Perception)
        column, row, depth = perception.tracker.pixels_on_top(true)
        hidden = float((self.exact[row, column] < depth - 0.005).mean())
        self.rows.append((distance, turn, hidden, seen.object.found))
        if self.pictures:
            self.frames.append(picture(image, self.arm.scenario, seen.object.pose, seen.tip_pose))

    def error(self, pose: ArrayLike, wanted: ArrayLike) -> tuple[float, float]:
        """Distance and angle of two poses, at the object's symmetry [m, rad]."""
        symmetry = np.array([float(self.arm.item.symmetry)])
        distance, turn = pose_errors(np.array([pose]), np.array([wanted]), symmetry)[0]
        return float(distance), abs(float(turn))


def picture(image: DepthImage, scenario: Scenario, pose: tuple, tip: tuple) -> NDArray[np.uint8]:
    """The camera's image beside the view from above, with the object where it is believed to be."""
    above = draw_top_view(scenario, pose, tip)
    near, far = 0.6, 1.3
    grey = np.clip((far - image.depth) / (far - near), 0, 1) * (image.depth > 0) * 255
    side = cv2.applyColorMap(grey.astype(np.uint8), cv2.COLORMAP_BONE)[..., ::-1]
    width = above.shape[0] * side.shape[1] // side.shape[0] // 2 * 2
    return np.hstack([cv2.resize(side, (width, above.shape[0])), above])


def run_episode(agent: str, sets: Sequence[str], number: int, video: Path | None = None) -> dict:
    """One push, and a row of figures. Five episodes of a set follow on five of the set before."""
    turn, place = divmod(number, 5)
    scenario = load_set(sets[turn % len(sets)]).scenarios[turn // len(sets) * 5 + place]
    arm = SimulatedRobot(scenario, aside=True)
    controller = PushController(agent, Perception(CAMERA, scenario.pushed_object))
    recorder, why = Recorder(arm, controller, video is not None), ""
    goal, direction = [*scenario.goal_position], 2.4 * number  # the golden angle: all directions
    if scenario.goal_yaw is not None:
        goal.append(scenario.goal_yaw)
    x, y, _ = scenario.object_pose
    guess = x + GUESS * math.cos(direction), y + GUESS * math.sin(direction)
    arm.connect()
    try:
        push(
            Guard(arm, controller, CAMERA),
            recorder.read_depth,
            goal,
            guess=guess,
            approach=arm.approach,
            on_step=recorder,
        )
    except Stopped as stopped:
        why = str(stopped)
    config = controller.agent.config.simulation
    away, turned = recorder.error(arm.object_pose, [*goal, 0.0][:3])
    arrived = away <= config.position_tolerance
    arrived &= scenario.goal_yaw is None or turned <= config.yaw_tolerance
    arm.close()
    if video is not None:
        imageio.mimwrite(video, recorder.frames, fps=15, macro_block_size=2)
    distance, angle, hidden, found = np.array(recorder.rows).reshape(-1, 4).T
    clear, within = hidden < 0.3, (distance <= 0.005) & (angle <= math.radians(5))
    return {
        "number": number,
        "scene": scenario.scene,
        "object": scenario.pushed_object,
        "success": bool(arrived and not why),
        "stopped": why,
        "images": len(within),
        "clear": int(clear.sum()),
        "clear_within": int((within & clear).sum()),
        "within": int(within.sum()),
        "worst_clear_mm": float(distance[clear].max(initial=0) * 1e3),
        "worst_clear_deg": float(np.degrees(angle[clear].max(initial=0))),
        "lost_s": longest((distance > LOST[0]) | (angle > LOST[1])) / controller.rate,
        "unconfirmed_s": longest(found == 0) / controller.rate,
    }


def longest(flags: NDArray[np.bool_]) -> int:
    """Length of the longest run of True."""
    return max((len([*run]) for flag, run in groupby(flags.tolist()) if flag), default=0)


def table(rows: pd.DataFrame) -> str:
    """The figures by scene family, as Markdown."""
    names = ["scene", "episodes", "solved", "clear images", "of these within 5 mm and 5°"]
    names += ["all images within 5 mm and 5°", "longest loss [s]", "longest unconfirmed [s]"]
    lines = [f"| {' | '.join(names)} |", "|---" * len(names) + "|"]
    for name, part in [*rows.groupby("scene"), ("all", rows)]:
        clear, images = part.clear.sum(), part.images.sum()
        shares = f"{part.clear_within.sum() / clear:.1%} | {part.within.sum() / images:.1%}"
        counts = f"{len(part)} | {part.success.mean():.2f} | {clear}"
        times = f"{part.lost_s.max():.2f} | {part.unconfirmed_s.max():.2f}"
        lines.append(f"| {name} | {counts} | {shares} | {times} |")
    return "\n".join(lines) + "\n"


def main(
    agent: str,
    out: Path,
    episodes: int = 20,
    first: int = 0,
    sets: Sequence[str] = SETS,
    processes: int = 1,
) -> pd.DataFrame:
    """Run the missing episodes, and write the table."""
    out.mkdir(parents=True, exist_ok=True)
    file = out / "episodes.csv"
    rows = pd.read_csv(file, keep_default_na=False).to_dict("records") if file.exists() else []
    numbers = range(first + len(rows), first + episodes)
    videos = [None if rows or i else out / "push.mp4" for i in range(len(numbers))]
    options = get_context("spawn"), torch.set_num_threads, (1,)
    with ProcessPoolExecutor(processes, *options) as pool:
        run = map if processes == 1 else pool.map
        found: Iterable[dict] = run(partial(run_episode, agent, sets), numbers, videos)
        for row in found:
            print(*row.values(), sep="  ", flush=True)
            rows.append(row)
            pd.DataFrame(rows).to_csv(file, index=False)
    results = pd.DataFrame(rows)
    (out / "report.md").write_text(table(results), encoding="utf-8")
    print(table(results))
    return results


if __name__ == "__main__":
    warnings.filterwarnings("ignore", message="Failed to find system libvulkan")
    torch.set_num_threads(1)
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    add = parser.add_argument
    add("--agent", default="any_object", help="an agent, or a folder of modpush export")
    add("--sets", nargs="+", default=SETS, help="evaluation sets, five episodes of each by turns")
    add("--episodes", type=int, default=20, help="number of episodes")
    add("--first", type=int, default=0, help="number of the first one")
    add("--processes", type=int, default=1, help="number of processes, each of which runs episodes")
    add("--out", type=Path, default=Path("runs/deploy"), help="folder of the results")
    main(**vars(parser.parse_args()))
