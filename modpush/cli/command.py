"""The command `modpush`, which finds the subcommand and imports no other."""

import ast
import difflib
import importlib
import io
import os
import re
import select
import signal
import sys
import textwrap
import traceback
import warnings
from collections.abc import Iterable, Sequence
from pathlib import Path

import modpush

SUBCOMMANDS = {
    "demo": "Watch a trained agent push different objects, beside the corridor controller.",
    "train": "Train an agent: environment and learner each in their own process, on two cores.",
    "evaluate": "Evaluate policies on the evaluation sets: tables, tests, pictures, videos.",
    "play": "Push in the browser, at `http://127.0.0.1:8080`, without a GPU or a renderer.",
    "collect": "Record demonstrations of any policies for offline learning, as Minari and ManiSkill data "
    "sets.",
    "export": "Write an agent's policy as ONNX or torch.export graphs, with a card.",
}
"""Purpose of each subcommand.

`modpush.cli.<name>` has a function `main(arguments)`, and its docstring is the help.
"""
_POSITIONAL = {"train": "PRESET ", "export": "[AGENT] "}


def run_command(arguments: Sequence[str] | None = None) -> int:
    """Run `modpush <subcommand> <arguments>`.

    Errors that the library raises itself are worded for the user and are shown without a traceback.

    Args:
        arguments: The command's arguments; by default those of the process.

    Returns:
        The exit status: 0, 2 for a usage error, 130 after an interrupt, 141 if the output was closed.
    """
    # A character that the terminal's encoding lacks is no error, here and in the processes started.
    os.environ.setdefault("PYTHONIOENCODING", ":replace")
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")
    name, *rest = [*(sys.argv[1:] if arguments is None else arguments)] or ["--help"]
    if name in ("-h", "--help"):
        print(_overview())
        return 0
    if name == "--version":
        print(f"modpush {modpush.__version__}")
        return 0
    if name not in SUBCOMMANDS:
        print(_unknown(name), file=sys.stderr)
        return 2
    if name == "train":
        # One thread for the learner; the other core is the environment's. Before torch is imported.
        os.environ.setdefault("OMP_NUM_THREADS", "1")
    warnings.filterwarnings("ignore", message="Failed to find system libvulkan")
    warnings.filterwarnings("ignore", module="torchvision")  # of parts that nothing here uses
    if not {"", os.getcwd()} & set(sys.path):
        sys.path.insert(0, os.getcwd())  # as `python -m` does, so that "module:name" is found there
    try:
        _run(name, rest)
    except KeyboardInterrupt as interrupt:
        if not interrupt.args or str(
            interrupt
        ):  # an empty text: the subcommand has printed its own
            print(f"\nmodpush {name}: {interrupt or 'Stopped.'}", file=sys.stderr)
        return 130
    except BrokenPipeError:
        if not _output_is_closed():
            raise
        return 128 + signal.SIGPIPE  # as of other programs: what was begun may not have ended
    except (ValueError, TypeError, OSError, ImportError, RuntimeError) as error:
        if not _is_ours(error):
            raise
        prefix = f"modpush {name}: "
        print(f"{prefix}{str(error).removeprefix(prefix)}", file=sys.stderr)
        return 2
    return 0


def _run(name: str, arguments: Sequence[str]) -> None:
    """Run a subcommand, and flush its output here: nothing catches an error when the interpreter ends."""
    if {"-h", "--help"} & {*arguments}:
        print(_help(name))
    else:
        if name == "train":
            check_preset(arguments)
        importlib.import_module(f"modpush.cli.{name}").main(arguments)
    sys.stdout.flush()


def _help(name: str) -> str:
    """Help of a subcommand: its module's docstring, read without importing torch, which takes seconds."""
    source = Path(__file__).with_name(f"{name}.py").read_text(encoding="utf-8")
    usage = f"usage: modpush {name} {_POSITIONAL.get(name, '')}[OPTIONS]"
    return f"{usage}\n\n{ast.get_docstring(ast.parse(source))}"


def check_preset(arguments: Sequence[str]) -> None:
    """Refuse arguments of `modpush train` that do not begin with a preset, without importing torch.

    Raises:
        ValueError: With the presets that there are, and the nearest of them.
    """
    section = _help("train").partition("\nPresets:\n")[2].partition("\n\n")[0]
    presets = re.findall(r"^  (\w+)", section, re.M)
    if not arguments or arguments[0] not in presets:
        got = f"{arguments[0]!r}.{_hint(arguments[0], presets)}" if arguments else "nothing."
        raise ValueError(f"expected a preset first, one of {', '.join(presets)}, got {got}")


def _output_is_closed() -> bool:
    """True if stdout was closed by its reader, such as `head`; further output is then discarded."""
    try:
        output = sys.stdout.fileno()
    except OSError:  # it is not a file, as in tests
        return False
    pipe = select.poll()
    pipe.register(output, 0)  # errors are always reported
    if not any(event & select.POLLERR for _, event in pipe.poll(0)):
        return False
    os.dup2(os.open(os.devnull, os.O_WRONLY), output)
    return True


def _overview() -> str:
    width = max(map(len, SUBCOMMANDS)) + 4
    lines = [
        textwrap.fill(
            text, 100, initial_indent=f"  {name:{width - 2}}", subsequent_indent=" " * width
        )
        for name, text in SUBCOMMANDS.items()
    ]
    return "\n".join(
        [
            "usage: modpush [--help] [--version] SUBCOMMAND ...",
            "",
            "Learning to push objects through clutter with a UR5 arm.",
            "",
            *lines,
            "",
            "`modpush SUBCOMMAND --help` lists the options of one.",
        ]
    )


def _unknown(name: str) -> str:
    known = ", ".join(SUBCOMMANDS)
    return f"modpush: no subcommand {name!r}, there are {known}.{_hint(name, SUBCOMMANDS)}"


def _hint(name: str, known: Iterable[str]) -> str:
    close = difflib.get_close_matches(name, known, n=1)
    return f" Did you mean {close[0]!r}?" if close else ""


def _is_ours(error: BaseException) -> bool:
    """True if the library raised an error itself, rather than a package that it uses."""
    frames = traceback.extract_tb(error.__traceback__)
    return bool(frames) and Path(frames[-1].filename).is_relative_to(Path(modpush.__file__).parent)
