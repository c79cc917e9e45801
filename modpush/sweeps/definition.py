"""What a sweep runs: variants of a training configuration, with several seeds each."""

import re
from collections.abc import Collection, Mapping
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import yaml

from modpush._arguments import checked_arguments
from modpush._checks import check_texts
from modpush._types import AtLeastOne, Count, Name, Seed
from modpush._validation import checked, from_plain
from modpush.files import parse_yaml, reading
from modpush.parts import check_allowed, find_part, part_module
from modpush.training.config import TrainConfig
from modpush.training.presets import TRAIN_PRESETS
from modpush.training.run_folder import RunFolder

__all__ = ["Sweep", "Trial", "Variant", "load_sweep", "override"]

_NAME = re.compile(r"[\w+-][\w.+-]*")


@checked
class Variant:
    """A training configuration, given by its differences from the sweep's."""

    name: Name
    """Name of the variant and of the folder that holds its runs: letters, digits and `_.+-`."""
    group: Name = "all"
    """Question that the variant answers; those of a group share a panel of the figure."""
    overrides: Mapping[Name, Any] = field(default_factory=dict)
    """Fields of `TrainConfig` by their dotted names, such as `env.encoder`, and their values."""

    def __post_init__(self) -> None:
        """Check the name, which becomes a folder's."""
        if not _NAME.fullmatch(self.name):
            raise ValueError(
                "Variant: name must be letters, digits and _.+- and not begin with a dot, got "
                f"{self.name!r}."
            )


@dataclass(frozen=True, kw_only=True)
class Trial:
    """One training run of a sweep."""

    variant: Variant
    """The variant that is trained."""
    seed: int
    """The run's seed."""
    config: TrainConfig
    """The whole configuration."""

    @property
    def name(self) -> str:
        """Variant and seed, which is also the run's folder in that of the sweep."""
        return f"{self.variant.name}/seed_{self.seed}"

    def folder(self, sweep_folder: Path) -> RunFolder:
        """The run's folder."""
        return RunFolder(Path(sweep_folder) / self.name, self.config.keep_checkpoints)


@checked
class Sweep:
    """Variants of one training configuration, each trained with several seeds.

    All runs have the same budget, that of the preset and its overrides, unless a variant overrides it.
    """

    preset: Name = "cpu"
    """Training preset to which all overrides apply, a name in `TRAIN_PRESETS`."""
    overrides: Mapping[Name, Any] = field(default_factory=dict)
    """Fields of `TrainConfig` that differ from the preset in all variants, by their dotted names."""
    variants: AtLeastOne[Variant]
    """Variants to compare; the others are compared with the first one."""
    seeds: AtLeastOne[Seed] = (0,)
    """Seeds with which every variant is trained."""

    def __post_init__(self) -> None:
        """Check what depends on several fields."""
        if self.preset not in TRAIN_PRESETS:
            raise ValueError(
                f"Sweep: preset must be one of {sorted(TRAIN_PRESETS)}, got {self.preset!r}."
            )
        given: dict[str, list[Any]] = {
            "variants": [variant.name for variant in self.variants],
            "seeds": list(self.seeds),
        }
        for name, values in given.items():
            if repeated := sorted({value for value in values if values.count(value) > 1}):
                raise ValueError(f"Sweep: {name} must differ, got {repeated} several times.")

    def of_groups(self, groups: Collection[str]) -> "Sweep":
        """The first variant, and those of some groups; all variants where none is named.

        Raises:
            ValueError: If there is no such group; the message lists the known ones.
        """
        check_texts("Sweep.of_groups", "groups", groups)
        chosen = set(groups)
        if unknown := sorted(chosen - {variant.group for variant in self.variants}):
            known = list(dict.fromkeys(variant.group for variant in self.variants))
            raise ValueError(f"Sweep: groups must be some of {known}, got {unknown}.")
        if not chosen:
            return self
        first, *others = self.variants
        return replace(self, variants=(first, *(v for v in others if v.group in chosen)))

    @checked_arguments
    def trials(self, total_steps: Count | None = None) -> tuple[Trial, ...]:
        """Every variant with every seed: all variants with the first seed, then with the next.

        Args:
            total_steps: Environment steps of each run; None for what the sweep says.

        Raises:
            ValueError: If an override is wrong; the message names variant and field.
        """
        base = override(TRAIN_PRESETS[self.preset][1], self.overrides, "Sweep.overrides")
        trials = []
        for seed in self.seeds:
            for variant in self.variants:
                who = f"Sweep, variant {variant.name!r}"
                config = override(base, {**variant.overrides, "seed": seed}, who)
                if total_steps is not None:
                    config = replace(config, total_steps=total_steps)
                config = replace(config, progress=False)
                if (file := config.env.encoder_file) is not None and not file.is_file():
                    raise ValueError(f"{who}: env.encoder must be an existing file, got '{file}'.")
                trials.append(Trial(variant=variant, seed=seed, config=config))
        return tuple(trials)


@checked_arguments
def override(config: TrainConfig, overrides: Mapping[str, Any], who: str) -> TrainConfig:
    """A training configuration with some fields set differently.

    Args:
        config: The configuration.
        overrides: Values as in JSON or YAML, by dotted names: `{"env.encoder": "rays"}`;
            words of a name may also be joined by `-`, as on the command line.
        who: Name of the caller, for error messages.

    Raises:
        ValueError: If there is no such field or its value is wrong; the message names it.
    """
    data = asdict(config)
    for name, value in overrides.items():
        *folders, last = name.replace("-", "_").split(".")
        inside: Any = data
        for folder in folders:
            if not isinstance(inside.get(folder), dict):
                raise ValueError(
                    f"{who}: there is no field {name!r} in TrainConfig, {folder!r} must be one of "
                    f"{sorted(key for key in inside if isinstance(inside[key], dict))}."
                )
            inside = inside[folder]
        inside[last] = value
    try:
        return from_plain(TrainConfig, data)
    except ValueError as error:
        raise ValueError(f"{who}: {error}") from None


@checked_arguments
def load_sweep(source: str | Path, *, allow: Collection[str] = ()) -> Sweep:
    """A sweep from a YAML file, or from Python code as `"module:name"`.

    Args:
        source: The file, which holds the fields of `Sweep`; or `"module:name"` of a `Sweep`, or of a
            list of variants, each a `Variant` or a mapping of its fields.
        allow: Modules and packages from which the file may name parts.

    Raises:
        ValueError: If there is no such file or object, it is not a sweep, or the file names modules that
            are not allowed; the message names the field.
    """
    path, text = Path(source), str(source)
    if path.is_file():
        with reading(path, "load_sweep"):
            try:
                sweep = from_plain(Sweep, parse_yaml(path.read_bytes()))
            except (ValueError, yaml.YAMLError) as error:
                raise ValueError(f"load_sweep: {path} holds no sweep: {error}") from None
            named = [sweep.overrides, *(variant.overrides for variant in sweep.variants)]
            check_allowed(f"load_sweep: {path}", named, allow)
            return sweep
    if part_module(text) is None:
        raise ValueError(f"load_sweep: source must be a file or 'module:name', got {text!r}.")
    found = find_part("load_sweep", text, {})
    if isinstance(found, list | tuple):
        variants = [v if isinstance(v, Variant) else from_plain(Variant, v) for v in found]
        return Sweep(variants=tuple(variants))
    if not isinstance(found, Sweep):
        raise ValueError(f"load_sweep: {text!r} must be a Sweep or a list of variants: {found!r}.")
    return found
