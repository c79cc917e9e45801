"""What README and the pages in docs/ show runs, and what they name exists."""

import ast
import re
import shlex
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
import torchrl  # noqa: F401  # its logger keeps the standard output of its first import
import tyro

from modpush.cli import run_command

ROOT = Path(__file__).resolve().parents[1]
PAGES = [*sorted(ROOT.glob("*.md")), *sorted((ROOT / "docs").rglob("*.md"))]
BLOCK = re.compile(r"^```python\n(?P<code>.*?)^```", re.S | re.M)
SCRIPT = 'if __name__ == "__main__":'
ANY_PYTHON = re.compile(
    r"^[ \t>]*(?:`{3,}|~{3,})[ \t]*\{?\.?(?:py\b|py3|ipython|pycon|python)", re.M | re.I
)
FENCE = re.compile(r"^```(\w*)\n(.*?)^```", re.S | re.M)
COMMAND = re.compile(r"^ *(?:\.venv/bin/|python -m )?modpush (?P<rest>[a-z].*)$", re.M)
QUICK = ("README.md", "docs/get_started.md", "docs/howto/bring_your_robot.md")
"""Pages whose blocks run among the quick tests."""
PRINTED = {
    "planners.md": ["tensor([True]) tensor([0.65", "[True]"],
    "evaluation.md": ["| mine | 4 |", "| success | 3 |"],
    "scaling.md": ["torch.Size([2, 8, 16])"],
}
"""Parts of what a page's blocks print, in order."""


def check_the_picture_of_the_flow(names: dict[str, Any]) -> None:
    """The picture in concepts.md shows keys that are emitted, or handed from transform to transform."""
    picture = (ROOT / "docs" / "pictures" / "flow.svg").read_text()
    shown = {
        key
        for text in re.findall(r'class="key"[^>]*>([^<]+)<', picture)
        for key in text.split(", ")
    }
    written = {key for part in names["env"].transform for key in part.out_keys}
    assert shown - names["emitted"] - written == set()
    assert {"depth", "occupancy", "subgoal", "window", "latent", "observation", "action"} <= shown


CHECKED: dict[str, Callable[[dict[str, Any]], None]] = {
    "concepts.md": check_the_picture_of_the_flow
}
"""What is checked of the names that a page's blocks leave behind."""


def title(page: Path) -> str:
    return page.relative_to(ROOT).as_posix()


def python_blocks(page: Path) -> list[str]:
    """A page's Python blocks, each on its own lines of the page, for readable tracebacks."""
    text = page.read_text()
    return [
        "\n" * text[: match.start("code")].count("\n") + match["code"]
        for match in BLOCK.finditer(text)
    ]


def run_script(block: str, path: Path) -> str:
    """Run a block that starts processes of its own as a program; what it printed."""
    path.write_text(block)
    ended = subprocess.run(
        [sys.executable, path], cwd=path.parent, capture_output=True, text=True, timeout=300
    )
    assert ended.returncode == 0, ended.stderr
    return ended.stdout


@pytest.mark.parametrize(
    "page",
    [
        pytest.param(page, id=title(page), marks=[] if title(page) in QUICK else pytest.mark.slow)
        for page in PAGES
        if python_blocks(page)
    ],
)
def test_the_python_blocks_of_a_page_run_one_after_the_other(
    page: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    names: dict[str, Any] = {"__name__": "page"}
    printed = ""
    for block in python_blocks(page):
        if SCRIPT in block:
            printed += run_script(block, tmp_path / "block.py")
        else:
            exec(compile(block, page, "exec"), names)
    printed += capsys.readouterr().out
    for part in PRINTED.get(page.name, ()):
        assert part in printed
        printed = printed.partition(part)[2]
    CHECKED.get(page.name, lambda names: None)(names)


def test_what_the_blocks_import_is_there() -> None:
    """For those that run among the slow tests."""
    for page in PAGES:
        for block in python_blocks(page):
            tree = ast.parse(block, page)
            imports = [n for n in ast.walk(tree) if isinstance(n, ast.Import | ast.ImportFrom)]
            names: dict[str, Any] = {"__name__": "page"}
            exec(compile(ast.Module(imports, type_ignores=[]), page, "exec"), names)


def test_no_python_block_escapes_the_tests() -> None:
    for page in PAGES:
        text = page.read_text()
        found = len(BLOCK.findall(text))
        assert len(ANY_PYTHON.findall(text)) == found, f"{page}: write ```python, not indented"


def shown_commands() -> Iterator[tuple[str, str]]:
    """Every line of a page's code that begins with `modpush`, once, and the first page that has it."""
    seen: set[str] = set()
    for page in PAGES:
        text = page.read_text().replace("\\\n", " ")
        fenced = [code for kind, code in FENCE.findall(text) if kind != "python"]
        indented = re.findall(r"^ {4}[^\n]*$", FENCE.sub("", text), re.M)
        for match in COMMAND.finditer("\n".join([*fenced, *indented])):
            command = match["rest"].partition("#")[0].strip()
            if command not in seen:
                seen.add(command)
                yield title(page), command


class Parsed(BaseException):  # not an Exception, which the command would report
    """The command's arguments were understood."""


def test_the_commands_on_the_pages_are_understood(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def stop_after(parse: Callable[..., Any]) -> Callable[..., Any]:
        def parse_and_stop(*args: Any, **kwargs: Any) -> Any:
            parse(*args, **kwargs)
            raise Parsed

        return parse_and_stop

    commands = list(shown_commands())
    assert len(commands) > 10
    monkeypatch.setattr(tyro, "cli", stop_after(tyro.cli))
    monkeypatch.setattr(
        tyro.extras, "overridable_config_cli", stop_after(tyro.extras.overridable_config_cli)
    )
    for page, command in commands:
        try:
            status = run_command(shlex.split(command))
        except Parsed:
            continue
        except SystemExit as ended:
            status = ended.code
        pytest.fail(f"{page}: modpush {command}: status {status}\n{capsys.readouterr().err}")


def test_every_page_is_in_the_navigation() -> None:
    navigation = (ROOT / "mkdocs.yml").read_text().partition("\nnav:")[2].partition("\nplugins:")[0]
    listed = set(re.findall(r"[\w/]+\.(?:md|ipynb)\b", navigation))
    made = {name for name in listed if name.startswith("project/")}
    docs = ROOT / "docs"
    there = {
        path.relative_to(docs).as_posix()
        for kind in ("md", "ipynb")
        for path in docs.rglob(f"*.{kind}")
    }
    assert listed - made - there == set()
    missing = {name for name in there - listed if not name.startswith("results/")}
    assert not missing, f"add these to `nav` in mkdocs.yml: {missing}"


def test_no_page_names_a_missing_target_or_file() -> None:
    makefile = (ROOT / "Makefile").read_text()
    named = set()
    for page in PAGES:
        text = page.read_text()
        for target in re.findall(r"(?:`|^)make ([a-z-]+)", text, re.MULTILINE):
            assert re.search(rf"^{target}:", makefile, re.MULTILINE), (page.name, target)
            named.add(target)
        for script in re.findall(r"\b((?:examples|benchmarks|tools)/[\w/]+\.(?:py|sh))", text):
            assert (ROOT / script).is_file(), (page.name, script)
        for test in re.findall(r"\b(tests/[\w/]+\.py)", text):
            assert (ROOT / test).is_file(), (page.name, test)
    assert {"demo", "test", "docs"} <= named
