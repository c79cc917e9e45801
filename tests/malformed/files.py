"""Files of every kind, read back, with the right ones."""

import functools
import shutil
import tempfile
from pathlib import Path
from typing import Any

import torch

from modpush.encoders import DepthVAE, WindowData
from modpush.evaluation import ResultStore, Trajectory, load_set
from modpush.evaluation.results import load_trajectory
from modpush.recipes import load_agent
from modpush.recipes.methods import get_method
from modpush.replay import AttentiveSampler
from modpush.training import RunFolder, check_run_folder
from modpush.training.presets import TRAIN_PRESETS
from modpush.viewer import ReplayLane
from tests.damage import KINDS
from tests.malformed.target import UNKNOWN, Target

SMOKE = TRAIN_PRESETS["smoke"][1]


@functools.cache
def folder() -> Path:
    """A folder that goes with the process."""
    keep = tempfile.TemporaryDirectory(prefix="malformed")
    _KEPT.append(keep)
    return Path(keep.name)


_KEPT: list[Any] = []


@functools.cache
def good(kind: str) -> Path:
    """A whole file of a kind, in a folder of its own."""
    place = folder() / kind.replace(" ", "_")
    place.mkdir()
    return KINDS[kind](place)[0]


def targets() -> list[Target]:
    """All of them."""
    return [*_readers(), *_folders()]


def _readers() -> list[Target]:
    named: dict[str, tuple[str, str, Any]] = {
        "load_agent": ("agent", "name", load_agent),
        "DepthVAE.from_pretrained": ("VAE weights", "name_or_path", DepthVAE.from_pretrained),
        "WindowData.load": ("windows", "path", WindowData.load),
        "load_set": ("evaluation set", "name", load_set),
        "Trajectory.load": ("trajectory", "path", Trajectory.load),
        "get_method": ("agent", "policy", lambda policy: get_method(str(policy))),
    }
    found = [
        Target(
            name=name,
            call=read,
            given=lambda kind=kind, argument=argument: {argument: good(kind)},
            bad={
                argument: [*UNKNOWN[1:3], good("trajectory" if kind != "trajectory" else "agent")]
            },
            files=[argument],
        )
        for name, (kind, argument, read) in named.items()
    ]
    weights = DepthVAE(2, (2, 3, 4, 5), (5, 4, 3, 2)).state_dict()
    first = next(iter(weights))
    return [
        *found,
        Target(
            name="load_agent(allow)",
            call=lambda allow: load_agent(good("agent"), allow=allow),
            given=lambda: {"allow": ("modpush",)},
            bad={"allow": [3, "modpush", (3,)]},
            only=["allow"],
        ),
        Target(
            name="DepthVAE.load_weights",
            call=DepthVAE(2, (2, 3, 4, 5), (5, 4, 3, 2)).load_weights,
            given=lambda: {"tensors": dict(weights)},
            bad={
                "tensors": [
                    {},
                    {**weights, first: weights[first] * torch.nan},
                    {**weights, first: weights[first].double()},
                    {**weights, first: weights[first][:1]},
                    {**weights, "extra": weights[first]},
                ]
            },
            only=["tensors"],
            also={"tensors": ["DepthVAE"]},
        ),
        Target(
            name="AttentiveSampler.loads",
            call=AttentiveSampler(2).loads,
            given=lambda: {"path": folder()},
            bad={"path": [Path("no such"), 3, None]},
            only=["path"],
        ),
    ]


def _copied(path: Path) -> Path:
    """A copy of a file in a new folder."""
    place = Path(tempfile.mkdtemp(dir=folder()))
    shutil.copy(path, place / path.name)
    return place / path.name


def _folders() -> list[Target]:
    from tests.malformed.values import wrong_file

    def damaged(kind: str, number: int) -> Path:
        import numpy as np

        path = _copied(good(kind))
        while True:
            _, wrong = wrong_file(path, np.random.default_rng([number]))
            if wrong.is_file():
                wrong.rename(path)
                return path.parent
            number += 1000

    smoke = load_set("smoke")
    return [
        Target(
            name="RunFolder.read_config",
            call=lambda number: RunFolder(damaged("config.yaml", number)).read_config(),
            given=lambda: {"number": 0},
            bad={"number": range(50)},
            only=["number"],
            also={"number": ["modpush.TrainConfig", "config.yaml"]},
        ),
        Target(
            name="ResultStore(damaged run.json)",
            call=lambda number: ResultStore(damaged("run.json", number), smoke, {"class": "made"}),
            given=lambda: {"number": 0},
            bad={"number": range(50)},
            only=["number"],
            also={"number": ["modpush.Results", "run.json"]},
        ),
        Target(
            name="ResultStore",
            call=ResultStore,
            given=lambda: {
                "folder": good("run.json").parent,
                "evaluation_set": smoke,
                "policy": {"class": "made"},
                "resume": True,
            },
            bad={
                "folder": [good("agent"), 3],
                "evaluation_set": ["smoke", None, load_set("free/small_cube")],
                "policy": [{"class": "other"}, 3, None],
            },
            only=["folder", "evaluation_set", "policy"],
            also={"evaluation_set": ["episodes", "set"], "folder": ["ResultStore"]},
        ),
        Target(
            name="load_trajectory",
            call=load_trajectory,
            given=lambda: {"folder": folder(), "number": 0},
            bad={"number": [0, 1, -1], "folder": [good("agent"), Path("no such")]},
            only=["folder", "number"],
            also={"number": ["modpush.Trajectory"], "folder": ["modpush.Trajectory"]},
        ),
        Target(
            name="check_run_folder",
            call=check_run_folder,
            given=lambda: {"path": good("config.yaml").parent, "config": SMOKE, "resume": True},
            bad={
                "path": [folder() / "none", good("agent"), 3],
                "config": [None, {}, TRAIN_PRESETS["cpu"][1]],
            },
            only=["path", "config"],
            also={"config": ["another config"], "path": ["check_run_folder"]},
        ),
        Target(
            name="ReplayLane",
            call=ReplayLane,
            given=lambda: {"folder": good("run.json").parent},
            bad={"folder": [folder() / "none", good("agent"), folder(), 3]},
            only=["folder"],
            also={"folder": ["ReplayLane"]},
        ),
    ]
