"""Demonstrations: collecting, reading and replaying them, with right arguments."""

import functools
from pathlib import Path
from typing import Any

import numpy as np

from modpush import data
from modpush.data.demonstration import FLAG_KEYS, POSE_KEYS
from modpush.envs import PushEnv
from tests.malformed.environments import env, stack
from tests.malformed.files import folder, good
from tests.malformed.target import UNKNOWN, Target
from tests.test_validation import SCENARIO


def targets() -> list[Target]:
    """All of them."""
    return [*_collecting(), *_reading()]


@functools.cache
def _demonstration() -> data.Demonstration:
    """One step of an episode, made by hand."""
    widths = dict(zip(POSE_KEYS, (3, 2, 3), strict=True))
    flags = np.zeros(1, dtype=bool)
    return data.Demonstration(
        policy="made",
        number=0,
        seed=1,
        scenario=SCENARIO,
        observation=np.zeros((2, 4), np.float32),
        action=np.zeros((1, 3), np.float32),
        command=np.zeros((1, 3), np.float32),
        reward=np.zeros(1, np.float32),
        terminated=flags,
        truncated=flags,
        poses={key: np.zeros((2, width), np.float32) for key, width in widths.items()},
        flags={key: np.zeros(2, dtype=bool) for key in FLAG_KEYS},
        physics=np.zeros((2, 9), np.float32),
        target=np.zeros((2, 3)),
    )


def _file() -> Path:
    path = folder() / "demonstration" / "0.npz"
    if not path.exists():
        _demonstration().save(path)
    return path


def _collecting() -> list[Target]:
    other = folder() / "other_demonstrations"
    data.DemonstrationStore(other, {"class": "other"})
    right = data.CollectConfig(policy=("scripted",), episodes=1, out=folder() / "collected")
    return [
        Target(
            name="collect_demonstrations",
            call=data.collect_demonstrations,
            given=lambda: {"config": right, "progress": False},
            bad={"config": [None, 3, {}, "scripted"], "progress": [None, "yes", 2]},
            only=["config", "progress"],
        ),
        Target(
            name="collect_demonstrations(policy)",
            call=lambda policy: data.collect_demonstrations(
                data.CollectConfig(policy=policy, out=folder() / "collected"), False
            ),
            given=lambda: {"policy": ("scripted",)},
            bad={"policy": [("no such",), (str(good("trajectory")),), ("agent", "agent"), (), 3]},
            only=["policy"],
            also={"policy": ["no such", "trajectory.npz"]},
        ),
        Target(
            name="DemonstrationStore",
            call=data.DemonstrationStore,
            given=lambda: {"folder": folder() / "store", "about": {"class": "made"}},
            bad={"folder": [good("agent"), other, 3, None], "about": [3, None, "text", [1]]},
            only=["folder", "about"],
            also={"folder": ["other_demonstrations"]},
        ),
        Target(
            name="RecordingEnv",
            call=data.RecordingEnv,
            given=lambda: {"env": stack(), "images": False},
            bad={"env": [None, 3, env(), "env", stack()], "images": [None, "yes", 2]},
            only=["env", "images"],
        ),
    ]


@functools.cache
def _one_scene() -> PushEnv:
    return PushEnv(1, scene="slot", depth=None, seed=0)


def _reading() -> list[Target]:
    def load(path: Any, **options: Any) -> Any:
        return data.load_demonstrations(path, **options)

    return [
        Target(
            name="load_demonstrations",
            call=load,
            given=lambda: {"path": folder() / "none", "policies": None, "only_success": False},
            bad={
                "path": [folder() / "none", good("agent"), Path("no such"), 3, None],
                "policies": ["scripted", 3, (3,)],
                "only_success": [None, "yes", 2],
            },
            only=["path", "policies", "only_success"],
        ),
        Target(
            name="Demonstration.load",
            call=data.Demonstration.load,
            given=lambda: {"path": _file()},
            bad={"path": [*map(Path, UNKNOWN[1:3]), good("trajectory")]},
            files=["path"],
        ),
        Target(
            name="replay_demonstration",
            call=data.replay_demonstration,
            given=lambda: {"demonstration": _demonstration(), "env": _one_scene()},
            bad={
                "demonstration": [None, 3, {}, _file()],
                "env": [None, 3, env(), stack(), "env"],
            },
            only=["demonstration", "env"],
        ),
    ]
