"""Write `docs/train_options.md`, the list of all options of `modpush train`, from the configurations.

python tools/train_options.py
"""

import ast
import inspect
import itertools
import textwrap
from dataclasses import asdict, fields, is_dataclass
from pathlib import Path
from typing import Any

import yaml

from modpush.cli import RunConfig
from modpush.mdp.curriculum import Phase
from modpush.training import TRAIN_PRESETS, TrainConfig

PAGE = Path(__file__).resolve().parents[1] / "docs" / "train_options.md"
INTRODUCTION = """\
<!-- Written by tools/train_options.py. -->

# Options of `modpush train`

`modpush train PRESET [OPTIONS]`. Every field below is an option, such as `--train.tqc.gamma 0.99` for
`tqc.gamma`; words may be joined by `-` or `_`, and a field that is true or false has two forms,
`--train.mirror` and `--train.no-mirror`. The fields of `TrainConfig` and of the configurations in it can
also be set by `--config FILE` ([how](training.md#settings-from-the-command-line)), and in Python they are
the arguments of these dataclasses. The defaults are those of the classes, which are the paper's where it
gives a value; a preset replaces some of them, [see below](#settings-of-the-presets). `--init-from`,
`--collector`, `--num-collectors` and `--minutes` are short for `--train.init-from`, `--train.collector`,
`--train.num-collectors` and `--train.max-minutes`."""


def page() -> str:
    """The whole page."""
    parts = [
        INTRODUCTION,
        *_section("The command", "--", RunConfig()),
        *_configs("", TrainConfig()),
    ]
    parts += [
        "## Settings of the presets",
        "The fields that differ from the defaults, as a file for `--config`. `modpush train --help` says "
        "what each preset is for.",
    ]
    for name, config in TRAIN_PRESETS.items():
        changed = yaml.safe_dump(
            _plain(_changes(TrainConfig(), config)),
            sort_keys=False,
            default_flow_style=None,
            width=110,
        )
        parts.append(f"### `{name}`\n\n```yaml\n{changed}```")
    return "\n\n".join(parts) + "\n"


def _configs(prefix: str, config: Any) -> list[str]:
    """A section for a configuration, and one for each that it holds."""
    parts = _section(f"`{type(config).__name__}`", prefix, config)
    for field in fields(config):
        name, value = field.name, getattr(config, field.name)
        if is_dataclass(value):
            parts += _configs(f"{prefix}{name}.", value)
        elif isinstance(value, tuple) and any(isinstance(item, Phase) for item in value):
            parts += _section("`Phase`", f"{prefix}{name}.0.", Phase())
    return parts


def _section(title: str, prefix: str, config: Any) -> list[str]:
    texts = _field_texts(type(config))
    lines = []
    for field in fields(config):
        name = f"{prefix}{field.name.replace('_', '-') if prefix == '--' else field.name}"
        value = getattr(config, field.name)
        if not is_dataclass(value):
            text = f"- `{name}` = `{_shown(value)}`: {texts[field.name]}"
            lines.append(textwrap.fill(text, 120, subsequent_indent="  ", break_on_hyphens=False))
    return [f"## {title}", "\n".join(lines)]


def _field_texts(config: type) -> dict[str, str]:
    """The docstring of each field of a configuration, as one line."""
    (made,) = ast.parse(textwrap.dedent(inspect.getsource(config))).body
    assert isinstance(made, ast.ClassDef)
    return {
        ast.unparse(line.target): " ".join(str(text.value.value).split())
        for line, text in itertools.pairwise(made.body)
        if isinstance(line, ast.AnnAssign)
        and isinstance(text, ast.Expr)
        and isinstance(text.value, ast.Constant)
    }


def _shown(value: Any) -> str:
    if isinstance(value, tuple) and any(map(is_dataclass, value)):
        value = tuple(asdict(item) for item in value)
    return str(_plain(value))


def _changes(default: Any, config: Any) -> dict[str, Any]:
    """The fields of a configuration that differ from another's, as nested mappings."""
    changes = {}
    for name in (field.name for field in fields(config)):
        value, before = getattr(config, name), getattr(default, name)
        if value != before:
            changes[name] = _changes(before, value) if is_dataclass(value) else value
    return changes


def _plain(data: Any) -> Any:
    """Tuples as lists, configurations as mappings, paths as text."""
    if isinstance(data, dict):
        return {name: _plain(value) for name, value in data.items()}
    if isinstance(data, list | tuple):
        return [_plain(item) for item in data]
    if is_dataclass(data) and not isinstance(data, type):
        return _plain(asdict(data))
    return str(data) if isinstance(data, Path) else data


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
