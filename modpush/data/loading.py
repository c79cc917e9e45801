"""`load_demonstrations`: collected episodes as transitions, and the environment they are of."""

import json
from collections.abc import Collection, Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from tensordict import TensorDict
from torch import Tensor
from torchrl.envs import EnvBase

from modpush._extras import require_extra
from modpush._validation import checked_arguments, from_plain
from modpush.files import reading
from modpush.parts import check_allowed
from modpush.recipes.config import PushEnvConfig
from modpush.recipes.fingerprint import environment_fingerprint, fingerprint_differences
from modpush.recipes.make_env import make_push_env

_PACKAGES = ("minari", "h5py")
_METADATA = "metadata.json"  # Minari's, beside the episodes


@dataclass(frozen=True, kw_only=True)
class Demonstrations:
    """Collected episodes: their transitions, and the environment in which they were recorded."""

    transitions: TensorDict
    """`observation` `[N, n]`, `action` `[N, 3]`, `episode` `[N]` int64, and under `"next"`
    `observation`, `reward`, `done`, `terminated` and `truncated` `[N, 1]`, one episode after the other:
    what `make_replay_buffer(...).extend` takes."""
    episodes: tuple[Mapping[str, Any], ...]
    """Properties of each episode, by its number in `episode`: `seed`, `policy`, `scene`,
    `pushed_object`, `success`, `scenario` (JSON)."""
    config: PushEnvConfig
    """Configuration of the environment, for `make_push_env`."""
    fingerprint: Mapping[str, Any]
    """Fingerprint of that environment, see `environment_fingerprint`."""

    def make_env(self, num_envs: int | None = None, **options: Any) -> EnvBase:
        """The environment that the episodes were recorded in.

        Args:
            num_envs: Number of scenes; by default the config's.
            **options: Further arguments of `make_push_env`.

        Raises:
            ValueError: If it observes, acts or rewards otherwise now; the message says what differs.
        """
        count = self.config.num_envs if num_envs is None else num_envs
        env = make_push_env(replace(self.config, num_envs=count), **options)
        differences = fingerprint_differences(self.fingerprint, environment_fingerprint(env))
        if differences:
            env.close()
            raise ValueError(
                "Demonstrations.make_env: this is not the environment that they were recorded in. "
                + "; ".join(differences)
            )
        return env


@checked_arguments
def load_demonstrations(
    path: Path | str,
    *,
    policies: Collection[str] | None = None,
    only_success: bool = False,
    allow: Collection[str] = (),
) -> Demonstrations:
    """Read what `modpush collect` wrote, from its Minari data set.

    Args:
        path: The folder that `collect_demonstrations` wrote to, or a Minari data set's folder in it.
        policies: Take only episodes of these policies.
        only_success: Take only episodes that reached the goal.
        allow: Modules and packages from which the data set may name parts of its environment.

    Raises:
        MissingExtraError: If Minari is not installed.
        FileNotFoundError: If there is no such data set.
        ValueError: If it is not modpush's or damaged, there are several, it names modules that are not
            allowed, or no episode is left.
    """
    require_extra("load_demonstrations", *_PACKAGES)
    from minari import MinariDataset

    folder = _find(Path(path))
    source = f"load_demonstrations: {folder}"
    with reading(folder / _METADATA, "load_demonstrations"):
        metadata = json.loads((folder / _METADATA).read_text(encoding="utf-8"))
        if "modpush" not in metadata:
            raise ValueError(
                f"load_demonstrations: {path} is not a data set of modpush; for others use TorchRL's "
                "MinariExperienceReplay."
            )
        if not {"observation_space", "action_space"} <= set(metadata):
            # Minari would make the environment, and import what its specification names.
            raise ValueError(f"{source} must hold its observation_space and action_space.")
        about = metadata["modpush"]
        config = from_plain(PushEnvConfig, about["env"])
        check_allowed(source, asdict(config), allow)
    dataset = MinariDataset(folder)
    known = [dict(m) for m in dataset.storage.get_episode_metadata(range(len(dataset)))]
    if policies is not None and (missing := set(policies) - set(about["policies"])):
        raise ValueError(
            f"load_demonstrations: policies must be some of {sorted(about['policies'])}, got "
            f"{sorted(missing)}."
        )
    chosen = [
        n
        for n, episode in enumerate(known)
        if (policies is None or episode["policy"] in policies)
        and (episode["success"] or not only_success)
    ]
    if not chosen:
        raise ValueError(f"load_demonstrations: no such episode in {path}.")
    parts = [
        _transitions(episode, number)
        for number, episode in enumerate(dataset.iterate_episodes(chosen))
    ]
    return Demonstrations(
        transitions=torch.cat(parts),
        episodes=tuple(known[n] for n in chosen),
        config=config,
        fingerprint=about["fingerprint"],
    )


def _find(path: Path) -> Path:
    """The folder with the data in a folder of a run or of a data set."""
    found = sorted({p.parent for p in path.rglob("main_data.hdf5")})
    found = [p for p in found if not p.name.startswith(".")]  # left by a killed process
    if not found:
        raise FileNotFoundError(
            f"load_demonstrations: there is no Minari data set in {path}; `modpush "
            "collect` writes one."
        )
    if len(found) > 1:
        raise ValueError(
            f"load_demonstrations: several data sets in {path}: {[str(p) for p in found]}; give one."
        )
    return found[0]


def _transitions(episode: Any, number: int) -> TensorDict:
    """The transitions of a Minari episode, `[T]`."""
    observation = torch.from_numpy(episode.observations)

    def column(values: np.ndarray) -> Tensor:
        return torch.from_numpy(np.asarray(values))[:, None]

    terminated, truncated = column(episode.terminations), column(episode.truncations)
    count = len(terminated)
    after = {
        "observation": observation[1:],
        "reward": column(episode.rewards).float(),
        "done": terminated | truncated,
        "terminated": terminated,
        "truncated": truncated,
    }
    return TensorDict(
        {
            "observation": observation[:-1],
            "action": torch.from_numpy(episode.actions),
            "episode": torch.full((count,), number),
            "next": TensorDict(after, batch_size=[count]),
        },
        batch_size=[count],
    )
