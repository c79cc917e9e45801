"""`export_agent`: an agent's policy as graphs on disk, with a card that says how to feed them."""

import io
import json
import math
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any, Literal, get_args

import torch
from torch import Tensor, nn
from torchrl.envs import Transform

import modpush
from modpush._atomic import make_folder, replacing
from modpush._extras import require_extra
from modpush._types import AtLeastOne
from modpush._validation import checked_arguments
from modpush.encoders.encode import Encode
from modpush.envs.robot.control import MotionConfig
from modpush.export.graphs import ObservationPolicy, WindowPolicy
from modpush.mdp.action_frame import ActionFrame
from modpush.mdp.push_observation import PushObservation
from modpush.recipes.agent_file import Agent
from modpush.recipes.fingerprint import describe_transforms

Format = Literal["onnx", "torch_export"]
FORMATS: tuple[str, ...] = get_args(Format)
"""Formats to export to."""
_ENDINGS = {"onnx": ".onnx", "torch_export": ".pt2"}
_ACTION = {
    "order": ["dx", "dy", "dyaw"],
    "range": [-1.0, 1.0],
    "scale": [0.02, 0.02, 0.05],
    "unit": ["m", "m", "rad"],
    "rate": "15 Hz",
}
"""Meaning of an action: it is multiplied by `scale` and moves the tool's commanded pose."""

_FRAMES = {
    "base": "the robot's base: x forward, y left, z = 0 on the table",
    "object": "x along the object's own x axis",
    "path": "x from the object's centre to the sub-goal; the base's where the two coincide",
}
"""Axes that a card may name."""
_WINDOW = (
    "Row 0 is +x of the frame and column 0 is +y, the object's centre is in the middle. A value is the "
    "height over the table over `max_height` [m], at most 1; 0 where nothing is. Object and robot "
    "are taken out. Beyond the image is `outside`: free (0) or blocked (1)."
)
_RECOVERY = (
    "Not in the graphs. When for `patience` steps neither the tip of the tool nor the object has gone "
    "farther than `tolerance` [m] along x or y, the agent takes another action for `duration` steps, in "
    "its own frame: (cos a, sin a, turn), with a = pi and turn = 1 the first time in an episode; each "
    "further time a grows by the golden angle, pi (3 - sqrt 5), and turn changes its sign. After every "
    "third time the next ones take two steps more."
)
_CONTACT_FILTER = (
    "Not in the graphs. An action in the base frame, also of a recovery, is replaced if it is predicted "
    "to bring the tool, of which what is lower than the obstacles counts, nearer to an obstacle than "
    "`clearance` [m], or the object that it pushes nearer than `object_clearance` [m] and a fifth of its "
    "motion (one that is nearer already may stay as near, down to half), or the object's centre nearer "
    "than `edge` [m] to where an episode ends, or if there would soon be no way left to push the object "
    "aside for a moving obstacle. Of `object_clearance` and `edge` less and less is kept where the "
    "object has not moved for 2 s: modpush.mdp.ContactFilter."
)
_PLANNING = (
    "Arguments of `OccupancyGrid` and `PlannerSubgoals`, lengths in metres. Cells outside `bounds`, made "
    "smaller by `margin` (larger where it is negative), are blocked; of several margins the first that "
    "leaves a way counts. With `widest` obstacles are inflated by the radius of the circumscribed "
    "circle where that leaves a way, else of the inscribed one. The first radius that is tried is larger "
    "by `clearance`."
)
_CONTROL = (
    "The tool points straight down, its tip `tip_height` over the table, which depends on the object. It "
    "moves to the commanded pose in a straight line within a step of 1 / `rate` s. `limits` are the "
    "tip's workspace in x and y, and what an agent's commands reach at most: a guard's limits lie above. "
    "Lengths in metres, angles in radians, per second."
)
_MEANINGS = {
    "observation": "entries, shifts and scales as under `observation`",
    "window": "heights around the object, cut as under `window`",
    "ee_pose": "tip of the tool, (x, y, yaw) [m, rad], base frame",
    "object_pose": "centre of the object, (x, y, yaw) [m, rad], base frame",
    "goal_position": "goal, (x, y) [m], base frame",
    "goal_pose": "goal of the object, (x, y, yaw) [m, rad], base frame",
    "pose_error": "distance of the object from that goal [m], and angle by which it is to be turned, "
    "counterclockwise, modulo its symmetry [rad]",
    "subgoal": "point of the path to push towards, (x, y) [m], base frame",
    "subgoal_past": "earlier sub-goals, by the ages `planning.subgoals.lags` [steps], (x, y) [m], base "
    "frame; in an episode's first steps the first one",
    "path_ahead": "points of the planned path after `planning.subgoals.ahead` [m] along it, also beyond "
    "corners and not past its end, (x, y) [m], base frame",
    "path_length": "length of the planned path from object to goal [m]",
    "joint_position": "joints of the arm, from base to flange [rad]",
    "object_contact": "whether the tool touches the object",
    "object_radius": "radius of the circle around the object's footprint [m]",
    "object_inscribed_radius": "radius of the circle inside the object's footprint [m]",
    "object_symmetry": "number of yaw angles at which the object looks the same; 0: all of them",
    "history": "the last 8 steps in which the object was touched or moved by more than 0.5 mm, newest "
    "first, zeros before there were as many; each in the object's frame at the beginning of the step: "
    "tip of the tool from the object's centre (x, y) [m], command (dx, dy) in [-1, 1], motion of the "
    "tip (x, y) and of the object (x, y) in the step [m], turn of the object [rad], 1 if the tool "
    "touched it, else 0",
    "object_dynamics": "mass [kg], friction, and centre of mass (x, y) in the object's frame [m]",
    "object_support": "how far the footprint reaches from the object's centre in 48 directions, evenly "
    "spaced counterclockwise from the object's own x axis [m]",
}
"""Inputs of the graphs, by the names that `make_push_env` gives them."""


@checked_arguments
def export_agent(
    agent: Agent, folder: str | Path, formats: AtLeastOne[Format] = ("onnx",)
) -> dict[str, Path]:
    """Write an agent's greedy policy as graphs.

    `policy` maps the observation to the action, `window_policy` the window and the state to the
    action; the batch size is free in both. `card.json` says what the inputs are.

    Args:
        agent: A trained agent, of `load_agent`.
        folder: Folder to write to.
        formats: `"onnx"` (needs the extra `export`), `"torch_export"`, or both.

    Returns:
        The files that were written, by their names.

    Raises:
        ValueError: If a format is unknown, or the agent's network cannot be exported.
        MissingExtraError: If what a format needs is not installed.
    """
    if "onnx" in formats:
        require_extra("export_agent: the format 'onnx'", "onnx", "onnxscript")
    folder = make_folder(folder)
    policy = ObservationPolicy(agent.actor)
    env = agent.make_env(2, keep_images=True, seed=0)
    try:
        example = env.reset()
        described, control = describe_transforms(env), _control(env)
        chain = _window_policy(policy, list(env.transform))
    finally:
        env.close()
    examples = {
        "policy": (policy, {"observation": example["observation"]}, ["action"]),
        "window_policy": (
            chain,
            {name: example[name] for name in chain.input_names},
            ["action", "command"],
        ),
    }
    written: dict[str, Path] = {}
    for name, (module, inputs, outputs) in examples.items():
        for kind in formats:
            path = folder / f"{name}{_ENDINGS[kind]}"
            _write(module.eval(), inputs, outputs, path, kind)
            written[path.name] = path
    card = {**_card(agent, examples, chain), **_settings(described), "control": control}
    with replacing(folder / "card.json") as unfinished:
        unfinished.write_text(json.dumps(card, indent=2) + "\n", encoding="utf-8")
    written["card.json"] = folder / "card.json"
    return written


def _control(env: Any) -> dict[str, Any]:
    """Motion of the tool that an arm has to follow to run the policy."""
    motion, rate, tool = MotionConfig(), env.simulation.control_freq, env.tool
    speed = motion.max_step * math.sqrt(2) * rate
    return {
        "rate": rate,
        "tip_height": {name: item.tool_height for name, item in env.pushed_objects.items()},
        "tool": {n: getattr(tool, n) for n in ("name", "length", "tip_half_extents", "mass")},
        "robot": {
            "name": env.robot.name,
            "joint_limits": {joint.name: joint.limits for joint in env.robot.joints},
        },
        "limits": {
            "low": motion.low,
            "high": motion.high,
            "speed": speed,
            "turn_speed": motion.max_turn * rate,
            "acceleration": 2 * speed * rate,  # from one direction to the opposite one
        },
        "meaning": _CONTROL,
    }


def _window_policy(policy: ObservationPolicy, transforms: Sequence[Transform]) -> WindowPolicy:
    """The chain from window and state to the action; a `MirroredObservation` is for training alone."""
    by_class = {type(transform): transform for transform in transforms}
    if PushObservation not in by_class:
        raise ValueError("export_agent: the agent's environment has no PushObservation.")
    encode, frame = by_class.get(Encode), by_class.get(ActionFrame)
    return WindowPolicy(
        policy,
        by_class[PushObservation],
        None if encode is None else encode.encoder,
        "base" if frame is None else frame.frame,
    )


def _settings(described: Mapping[str, Any]) -> dict[str, Any]:
    """Origin of the graphs' inputs, and the policies beside the graphs."""
    explained = {
        name: {**described[name], "meaning": meaning} if name in described else None
        for name, meaning in (
            ("window", _WINDOW),
            ("recovery", _RECOVERY),
            ("contact_filter", _CONTACT_FILTER),
        )
    }
    planning = {
        name: described[name]
        for name in ("occupancy", "swept_obstacles", "subgoals")
        if name in described
    }
    return {**explained, "planning": {**planning, "meaning": _PLANNING}, "frames": _FRAMES}


def _write(
    module: nn.Module,
    inputs: Mapping[str, Tensor],
    outputs: Sequence[str],
    path: Path,
    kind: str,
) -> None:
    batch = torch.export.Dim("batch", min=1)
    values = tuple(inputs.values())
    shapes: Any = tuple({0: batch} for _ in values)
    if isinstance(module, WindowPolicy):  # its inputs are one variadic argument
        shapes = (shapes,)
    with warnings.catch_warnings(), torch.no_grad():
        warnings.simplefilter("ignore")  # torch's and onnxscript's own, about their internals
        program = torch.export.export(module, values, dynamic_shapes=shapes)
        if kind == "torch_export":
            packed = io.BytesIO()
            torch.export.save(program, packed)
            with replacing(path) as unfinished:
                unfinished.write_bytes(packed.getvalue())
            return
        graph = torch.onnx.export(
            program,
            (),
            input_names=list(inputs),
            output_names=list(outputs),
            dynamic_shapes=tuple({0: "batch"} for _ in inputs),  # names the axis, else "s15"
            dynamo=True,
            optimize=True,
            verbose=False,
        )
        assert graph is not None  # with dynamo=True there always is one
        with replacing(path) as unfinished:
            graph.save(str(unfinished), external_data=False)


def _card(agent: Agent, graphs: Mapping[str, Any], chain: WindowPolicy) -> dict[str, Any]:
    """Meaning of the graphs' inputs and outputs, as plain data."""
    return {
        "modpush": modpush.__version__,
        "graphs": {
            name: {
                "inputs": [
                    {
                        "name": key,
                        "shape": ["batch", *value.shape[1:]],
                        "dtype": str(value.dtype).removeprefix("torch."),
                        "meaning": _MEANINGS.get(key),
                    }
                    for key, value in inputs.items()
                ],
                "outputs": [
                    {"name": key, "shape": ["batch", 3], "dtype": "float32"} for key in outs
                ],
            }
            for name, (_, inputs, outs) in graphs.items()
        },
        "observation": agent.fingerprint.get("observation"),
        "action": {**_ACTION, "frame": chain.action_frame},
        "command": {**_ACTION, "frame": "base"},
        "environment": asdict(agent.config),
        "fingerprint": dict(agent.fingerprint),
    }
