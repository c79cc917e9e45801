"""YAML by the rules of version 1.2: `3e-4` is a number, `off` and `2026-01-01` are text.

PyYAML follows version 1.1, by which these are a text, False and a date.
"""

import re
from collections.abc import Mapping
from typing import Any

import yaml

_SCALARS = {
    "bool": (r"true|True|TRUE|false|False|FALSE", [*"tTfF"]),
    "null": (r"~|null|Null|NULL|", ["~", "n", "N", ""]),
    "int": (r"[-+]?[0-9][0-9_]*|0o[0-7]+|0x[0-9a-fA-F]+", [*"-+0123456789"]),
    "float": (
        r"[-+]?(\.[0-9]+|[0-9][0-9_]*(\.[0-9]*)?)([eE][-+]?[0-9]+)?"
        r"|[-+]?\.(inf|Inf|INF)|\.(nan|NaN|NAN)",
        [*"-+.0123456789"],
    ),
    "merge": ("<<", ["<"]),
}
"""Forms of scalars that are no text, and the characters that they begin with."""


class _Loader(yaml.SafeLoader):
    yaml_implicit_resolvers: dict[str, Any] = {}  # noqa: RUF012 (as PyYAML declares it)

    def construct_yaml_int(self, node: yaml.ScalarNode) -> int:
        return int(node.value, 0 if node.value[:2] in ("0o", "0x") else 10)


for _name, (_form, _first) in _SCALARS.items():
    _pattern = re.compile(f"^(?:{_form})$")
    _Loader.add_implicit_resolver(f"tag:yaml.org,2002:{_name}", _pattern, _first)
_Loader.add_constructor("tag:yaml.org,2002:int", _Loader.construct_yaml_int)


class _Dumper(yaml.SafeDumper):
    """Quotes text that the loader would take for something else."""

    yaml_implicit_resolvers = _Loader.yaml_implicit_resolvers


def load_yaml(text: str | bytes) -> Any:
    """Plain data from YAML.

    Raises:
        yaml.YAMLError: If it is no YAML.
    """
    return yaml.load(text, _Loader)


def dump_yaml(data: Mapping[str, Any]) -> str:
    """YAML that `load_yaml` reads as the same data."""
    return yaml.dump(dict(data), Dumper=_Dumper, sort_keys=False)
