"""Beginning a run with weights that are trained already."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch
from torch import Tensor
from torchrl.objectives import LossModule

from modpush._state import check_weights
from modpush.files import reading
from modpush.parts import ModulesRefusedError, modules_named
from modpush.recipes.agent_file import Agent, load_agent, observed_symmetry, shipped_agents
from modpush.recipes.fingerprint import fingerprint_differences
from modpush.recipes.make_env import ENV_PARTS
from modpush.training.config import TrainConfig
from modpush.training.learner import Learner
from modpush.training.run_folder import CHECKPOINT_KIND, Checkpoints, RunFolder, read_checkpoint
from modpush.training.scene_worker import WorkerSpecs

_OF_YAW = {"object_axis", "object_symmetry"}
"""Entries of the observation that depend on the object's symmetry."""


def load_initial_weights(
    learner: Learner, config: TrainConfig, specs: WorkerSpecs, parts: Mapping[str, Any]
) -> None:
    """Put the weights that `config.init_from` names into a learner that has learned nothing.

    Of an agent these are the actor's, whose file may name parts from the modules that the run's own
    config names; of a run or a checkpoint those of the critics, the targets and the temperature, too.
    All else is the run's own. What the environment observes must mean the same as in the run that the
    weights are from, but may be more: the weights of further entries begin at zero. The reward may be
    another.

    Raises:
        ValueError: If there are no such weights, they are of another architecture, or the environment
            observes something else; the message says what.
    """
    source = str(config.init_from)
    checkpoint = _find_checkpoint(Path(source))
    caller = f"TrainConfig: init_from {source!r}"
    if checkpoint is None:
        agent, symmetry = _load_agent(caller, source, config, parts)
        _check_environment(caller, agent.fingerprint, symmetry, config, specs, parts)
        actor = learner.agent.actor
        own, given = actor.state_dict(), agent.actor.state_dict()
        given = _widened(own, given, agent.fingerprint, specs)
        check_weights(source, own, given)
        actor.load_state_dict(given)
        _copy_to_targets(learner.agent.loss)
        return
    with reading(checkpoint, CHECKPOINT_KIND):
        state = read_checkpoint(checkpoint)
        fingerprint, stored = dict(state["fingerprint"]), dict(state["loss"])
        symmetry = state["symmetry"]
    _check_environment(caller, fingerprint, symmetry, config, specs, parts)
    loss = learner.agent.loss
    own, given = loss.state_dict(), _weights_in(stored)
    given = _widened(_weights_in(own), given, fingerprint, specs)
    check_weights(source, _weights_in(own), given)
    loss.load_state_dict({**own, **given})


def _load_agent(
    caller: str, source: str, config: TrainConfig, parts: Mapping[str, Any]
) -> tuple[Agent, int | None]:
    """The agent that a file or name stands for, and the symmetry of the object that it observed."""
    if source not in shipped_agents() and not Path(source).is_file():
        raise ValueError(
            f"{caller}: expected a run's folder, a checkpoint, an agent's file, or a shipped agent "
            f"({', '.join(shipped_agents())}); there is nothing of that name."
        )
    own = config.fixed_fields()
    named = modules_named([own["env"], own["tqc"]])
    given = {kind: part for kind, part in parts.items() if kind in (*ENV_PARTS, "actor")}
    try:
        agent = load_agent(source, parts=given, allow=sorted(named))
    except ModulesRefusedError as error:
        raise ValueError(
            f"{caller}: it was trained with parts that this run does not have; name them in this "
            f"run's config, or give them to the Trainer as parts. ({error})"
        ) from error
    if (was := agent.missing.get("pushed_object")) is not None:  # no file can name it
        raise ValueError(
            f"{caller}: it was trained with {was} as pushed_object; give it to the Trainer as "
            "parts={'pushed_object': ...}."
        )
    return agent, observed_symmetry(agent.config, agent.parts.get("pushed_object"))


def _weights_in(state: Mapping[str, Any]) -> dict[str, Any]:
    """Entries of networks and temperature in a loss's `state_dict`, without its settings."""
    kinds = {name: name.partition(".")[0] for name in state}
    return {
        name: value
        for name, value in state.items()
        if kinds[name].endswith("_params") or kinds[name] == "log_alpha"
    }


def _widened(
    own: Mapping[str, Any], given: Mapping[str, Any], stored: Mapping[str, Any], specs: WorkerSpecs
) -> dict[str, Any]:
    """Weights of networks that observe entries of their own as well, whose weights are zero.

    `own` are the weights of the networks that observe more, `given` those to take over, and `stored` is
    the fingerprint of the environment that these were trained in. In the inputs of a network, the
    observation comes first.
    """
    names = [entry["name"] for entry in stored.get("observation", {}).get("entries", ())]
    if not names or set(names) == set(specs.columns) or not set(names) <= set(specs.columns):
        return dict(given)
    ends = [(specs.columns[name].start, specs.columns[name].stop) for name in names]
    known = [column for start, stop in ends for column in range(start, stop)]
    width = max(columns.stop for columns in specs.columns.values())
    widened = dict(given)
    for name, value in given.items():
        whole = own.get(name)
        if not isinstance(whole, Tensor) or whole.ndim != value.ndim or whole.ndim < 2:
            continue
        if whole.shape[-1] - value.shape[-1] != width - len(known):
            continue
        after = range(width, whole.shape[-1])  # the action, which a critic reads
        widened[name] = torch.zeros_like(whole)
        widened[name][..., [*known, *after]] = value.to(whole)
    return widened


def _find_checkpoint(path: Path) -> Path | None:
    """The checkpoint that a path names: the file itself, or the newest in a run's folder."""
    if not path.is_dir():
        return path if Checkpoints.is_checkpoint(path) else None
    newest = RunFolder(path).checkpoints.latest()
    if newest is None:
        raise ValueError(
            f"TrainConfig: init_from must be a run with a checkpoint, {path} has none."
        )
    return newest


def _check_environment(
    caller: str,
    stored: Any,
    symmetry: int | None,
    config: TrainConfig,
    specs: WorkerSpecs,
    parts: Mapping[str, Any],
) -> None:
    """Refuse weights that were trained to read another observation, or more than there is."""
    own = {name: value for name, value in specs.fingerprint.items() if name != "reward"}
    given = {name: value for name, value in stored.items() if name != "reward"}
    if given.get("observation") and own.get("observation"):
        known = {entry["name"] for entry in given["observation"]["entries"]}
        shared = [e for e in own["observation"]["entries"] if e["name"] in known]
        own["observation"] = {**own["observation"], "entries": shared}
    if differences := fingerprint_differences(given, own):
        raise ValueError(f"{caller}: trained in another environment. " + "; ".join(differences))
    entries = {entry["name"] for entry in own.get("observation", {}).get("entries", ())}
    now = observed_symmetry(config.env, parts.get("pushed_object"))
    if entries & _OF_YAW and symmetry != now:
        raise ValueError(
            f"{caller}: trained with objects that count as looking the same at {symmetry} yaw angles, "
            f"those of this run at {now}; set env.symmetry to {symmetry}."
        )


def _copy_to_targets(loss: LossModule) -> None:
    """Have the targets of actor and encoder begin as these, whose weights have just been loaded."""
    children: dict[str, Any] = dict(loss.named_children())
    for name in ("actor_network_params", "encoder_params"):
        if f"target_{name}" in children:
            children[f"target_{name}"].data.update_(children[name].data)
