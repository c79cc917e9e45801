"""Stored episodes of an evaluation, shown step by step."""

import json
from collections.abc import Collection
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from modpush._validation import checked_arguments
from modpush.envs.outcome import is_at_goal, is_out_of_bounds
from modpush.envs.robot.named import find_robot, find_tool
from modpush.envs.scenes.objects import get_object
from modpush.envs.scenes.scenario import Scenario
from modpush.evaluation.results import SET_FILE, load_trajectory
from modpush.evaluation.sets import SET_NAMES, EvaluationSet, load_set
from modpush.files import reading
from modpush.geometry.workspace import WORKSPACE
from modpush.viewer.lane import FLAGS, Snapshot

_ABOUT = "run.json"


class ReplayLane:
    """Episodes that `modpush.evaluation.evaluate` stored.

    Args:
        folder: The folder that it wrote for a policy and a set, or that of a policy with a single set.
        allow: Modules and packages from which the set's file may name objects and scenes.

    Raises:
        ValueError: If the folder holds no episodes, or those of several sets; if its set has
            changed since.
    """

    @checked_arguments
    def __init__(self, folder: Path | str, *, allow: Collection[str] = ()) -> None:
        self.folder = _folder_of_set(Path(folder))
        with reading(self.folder / _ABOUT, "ReplayLane"):
            facts = json.loads((self.folder / _ABOUT).read_text(encoding="utf-8"))
            facts = {name: str(facts[name]) for name in ("set", "episodes")}
        own = self.folder / SET_FILE
        if not own.exists() and facts["set"] not in SET_NAMES:
            raise ValueError(
                f"ReplayLane: {self.folder} is of {facts['set']!r}, which is not a set of the package, "
                f"and holds no {SET_FILE}; evaluate it again."
            )
        self.set: EvaluationSet = load_set(own if own.exists() else facts["set"], allow=allow)
        """The episodes that were evaluated."""
        if not own.exists() and self.set.digest != facts["episodes"]:
            raise ValueError(f"ReplayLane: {self.folder} is of other episodes than {facts['set']}.")
        conditions = self.set.conditions
        self._robot, self._tool = find_robot(conditions.robot), find_tool(conditions.tool)
        self.name = f"{_policy_name(self.folder, facts['set'])}, {facts['set']}"
        self.numbers = sorted(int(p.stem) for p in self.folder.glob("trajectories/*.npz"))
        """Numbers of the stored episodes."""
        if not self.numbers:
            raise ValueError(f"ReplayLane: {self.folder} holds no trajectories yet.")

    def start(self, scenario: Scenario, number: int) -> Snapshot:
        """Show an episode from its beginning.

        Raises:
            ValueError: If it is not stored.
        """
        if number not in self.numbers:
            raise ValueError(f"ReplayLane: {self.folder} has no episode {number}.")
        self._scenario, self._step = scenario, 0
        self._course = load_trajectory(self.folder, number)
        item = get_object(scenario.pushed_object)
        self._tip_height = item.tool_height
        self._joints = np.array([self._robot.home])
        return self._snapshot()

    def step(self) -> Snapshot:
        """Show the next step."""
        self._step = min(self._step + 1, len(self._course.contacts))
        return self._snapshot()

    def _snapshot(self) -> Snapshot:
        k, course = self._step, self._course
        x, y, yaw = course.object_pose[k].tolist()
        tool_x, tool_y, tool_yaw = course.ee_pose[k].tolist()
        base_x, base_y, base_z = self._robot.base
        flange = self._tip_height + self._tool.length - base_z
        pose = np.array([[tool_x - base_x, tool_y - base_y, flange, tool_yaw]])
        self._joints = self._robot.inverse(pose, self._joints)[0]
        last = k == len(course.contacts)
        position, goal = np.array([[x, y]]), np.array([self._scenario.goal_position])
        at_goal = bool(is_at_goal(position, goal)[0])
        outside = bool(is_out_of_bounds(position, WORKSPACE.bounds())[0])
        touched = course.contacts[k - 1].tolist() if k else [False] * 3
        target = course.target[min(k, len(course.target) - 1)] if len(course.target) else None
        return Snapshot(
            scenario=self._scenario,
            object_pose=(x, y, yaw),
            ee_pose=(tool_x, tool_y, tool_yaw),
            joint_position=self._joints[0],
            robot=self._robot,
            tool=self._tool,
            step=k,
            flags=dict(zip(FLAGS, [*touched, at_goal, outside], strict=True)),
            ended=last,
            path=course.planned_path.astype(np.float64),
            subgoal=None if target is None else (float(target[0]), float(target[1])),
        )

    def reconstruction(self) -> NDArray[np.float32] | None:
        """Stored episodes hold no windows."""
        return None

    def close(self) -> None:
        """Nothing is held."""


def _folder_of_set(folder: Path) -> Path:
    """The folder itself if an evaluation's episodes are in it, else the only one in it where they are."""
    if not folder.is_dir():
        raise ValueError(f"ReplayLane: there is no folder {folder}.")
    found = sorted(path.parent for path in folder.rglob(_ABOUT))
    if folder in found:
        return folder
    if not found:
        raise ValueError(
            f"ReplayLane: folder must be an evaluation's, with {_ABOUT}, got {folder}."
        )
    if len(found) > 1:
        raise ValueError(
            f"ReplayLane: {folder} holds several sets, give one of {', '.join(map(str, found))}."
        )
    return found[0]


def _policy_name(folder: Path, set_name: str) -> str:
    """The part of an evaluation's folder before the set's name, which is the policy's, if it is there."""
    before = folder.resolve().as_posix().removesuffix(f"/{set_name}")
    return Path(before).name
