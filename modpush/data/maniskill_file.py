"""Demonstrations in ManiSkill's trajectory format: an HDF5 file, and a JSON file beside it."""

import json
from collections.abc import Iterable
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import modpush
from modpush._atomic import replacing
from modpush.data.demonstration import Demonstration
from modpush.envs.robot.ur5_2f85 import TOOLS, ToolName
from modpush.envs.scenes.objects import get_object
from modpush.files import write_text
from modpush.recipes.config import PushEnvConfig

__all__ = ["write_maniskill"]

_ENV_ID = "modpush.envs:ClutterPush-v1"
"""With the module that registers it, so that ManiSkill's own scripts find it."""
_BODY = 13  # numbers of a free body's state
_CONTACTS = ("object_contact", "obstacle_contact", "tool_obstacle_contact")


def write_maniskill(
    path: Path, demonstrations: Iterable[Demonstration], config: PushEnvConfig
) -> None:
    """Write trajectories of `ClutterPush-v1`, as ManiSkill's `RecordEpisode` does.

    Observations are those of the mode `state_dict`, actions are commands in the base frame for the
    control mode `planar`, rewards are sparse. The JSON file's episodes also have the `policy`.

    Args:
        path: The `.h5` file; the JSON file has the same stem.
        demonstrations: The episodes.
        config: Environment that they were recorded in.
    """
    import h5py

    episodes: list[dict[str, Any]] = []
    with replacing(path) as unfinished, h5py.File(unfinished, "w") as file:
        for number, found in enumerate(demonstrations):
            group = file.create_group(f"traj_{number}", track_order=True)
            _write_group(group, _trajectory(found, config.simulation.tool))
            episodes.append(
                {
                    "episode_id": number,
                    "episode_seed": found.seed,
                    "control_mode": "planar",
                    "elapsed_steps": len(found),
                    "reset_kwargs": {"seed": found.seed},
                    "success": found.success,
                    "policy": found.policy,
                }
            )
    about = {
        "env_info": {
            "env_id": _ENV_ID,
            "env_kwargs": _env_kwargs(config),
            "max_episode_steps": config.simulation.max_episode_steps,
        },
        "episodes": episodes,
        "source_type": "rl",
        "source_desc": f"modpush {modpush.__version__}, see the card",
    }
    write_text(path.with_suffix(".json"), json.dumps(about, indent=2) + "\n")


def _env_kwargs(config: PushEnvConfig) -> dict[str, Any]:
    return {
        **json.loads(json.dumps(asdict(config.filled_scenario()))),  # tuples as lists
        "robot_uids": f"ur5_{config.simulation.tool}",
        "sim_freq": config.simulation.sim_freq,
        "obs_mode": "state_dict",
        "reward_mode": "sparse",
        "sim_backend": "physx_cpu",
    }


def _trajectory(found: Demonstration, tool: ToolName) -> dict[str, Any]:
    """The content of one `traj_<n>`, `[T + 1, ...]` for states and observations, else `[T, ...]`."""
    actor, arm = _states(found.physics)
    item = get_object(found.scenario.pushed_object)
    height = np.full((len(found) + 1, 1), item.tool_height + TOOLS[tool].length)
    controller = {"target": found.target, "flange_height": height}
    joints, rates = np.split(arm[:, _BODY:], 2, axis=1)
    return {
        "obs": {
            "agent": {"qpos": joints, "qvel": rates, "controller": controller},
            "extra": {
                **found.poses,
                **{key: found.flags[key].astype(np.float32)[:, None] for key in _CONTACTS},
            },
        },
        "actions": found.command,
        "terminated": found.terminated,
        "truncated": found.truncated,
        "success": found.flags["success"][1:],
        "env_states": {
            "actors": {item.name: actor},
            "articulations": {f"ur5_{tool}": arm},
            "controller": controller,
            "layout": np.tile(
                np.array(found.scenario.layout_code, np.float32), (len(found) + 1, 1)
            ),
        },
        "rewards": found.flags["success"][1:].astype(np.float32),
    }


def _states(physics: NDArray[np.float32]) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """ManiSkill's states of object `[T + 1, 13]` and arm `[T + 1, 25]`, of `body_state`.

    A body is quaternion, position and velocities there, and position, quaternion and velocities here.
    """
    free, joints = physics[:, : 2 * _BODY], physics[:, 2 * _BODY :]
    bodies = [
        np.concatenate([body[:, 4:7], body[:, :4], body[:, 7:]], axis=1)
        for body in np.split(free, 2, axis=1)
    ]
    return bodies[0], np.concatenate([bodies[1], joints], axis=1)


def _write_group(group: Any, content: dict[str, Any]) -> None:
    for key, value in content.items():
        if isinstance(value, dict):
            _write_group(group.create_group(key, track_order=True), value)
        else:
            group.create_dataset(key, data=value, dtype=value.dtype)
