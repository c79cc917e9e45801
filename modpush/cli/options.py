"""Options of a subcommand from the fields of its configuration."""

import ast
import inspect
import itertools
import textwrap
from collections.abc import Sequence
from dataclasses import fields, is_dataclass
from types import MappingProxyType
from typing import Any, TypeVar

import tyro

__all__ = ["field_texts", "parse_options"]

T = TypeVar("T")


def parse_options(config: type[T], command: str, description: str, arguments: Sequence[str]) -> T:
    """A configuration from the arguments of a subcommand; with `--help`, its help and the exit.

    Args:
        config: Class of the configuration.
        command: Name of the command, for the help.
        description: What it does, for the help.
        arguments: The command's arguments.
    """
    _describe_fields(config)
    # tyro joins the lines that begin with a letter, and wraps none of them.
    description = textwrap.indent(description, " ")
    return tyro.cli(config, prog=command, description=description, args=[*arguments])


def field_texts(config: type) -> dict[str, str]:
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


def _describe_fields(config: type[Any]) -> None:
    """Give tyro the fields' docstrings as one line: in its own reading their line breaks stay."""
    texts = field_texts(config)
    for field in fields(config):
        if field.name in texts:
            field.metadata = MappingProxyType({**field.metadata, "help": texts[field.name]})
        if isinstance(field.type, type) and is_dataclass(field.type):
            _describe_fields(field.type)
