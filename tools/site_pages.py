"""Pages of the site that are made from the repository: a hook of MkDocs.

- `api/<package>.md` for each package with a public face (`__init__.pyi`), from its docstrings.
- `project/` with CHANGELOG and CONTRIBUTING.
- `source/` with every file outside of `docs/` that a page links to, so that no link leaves the site.
"""

import os
import re
from pathlib import Path
from typing import Any

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

ROOT = Path(__file__).resolve().parents[1]
LINK = re.compile(r"\]\((?P<path>[^)#:\s]+)(?P<anchor>#[^)]*)?\)")


def public_names(face: Path) -> list[str]:
    """Names that a package's `__init__.pyi` gives, in order."""
    names = re.findall(r"\bas (\w+)", face.read_text(encoding="utf-8"))
    return [name for name in names if not name.startswith("_")]


def packages() -> list[Path]:
    """Folders of the packages that have a public face."""
    return sorted(face.parent for face in (ROOT / "modpush").glob("*/__init__.pyi"))


def api_page(package: Path) -> str:
    """Markdown of a package's page: what the package is for, and every public name."""
    name = f"modpush.{package.name}"
    intro = f"# {name}\n\n::: {name}\n    options: {{members: false, show_root_heading: false}}\n"
    names = public_names(package / "__init__.pyi")
    return "\n".join([intro, *(f"::: {name}.{member}" for member in names), ""])


def outside_file(page: str, link: str) -> Path | None:
    """The file outside of `docs/` that a page's link leads to, if it leads to one."""
    target = Path(os.path.normpath(ROOT / "docs" / Path(page).parent / link))
    inside = target.is_relative_to(ROOT / "docs")
    return None if inside or not target.is_file() or ROOT not in target.parents else target


def source_page(file: Path) -> tuple[str, str]:
    """Address and Markdown of the page that shows a file."""
    name = file.relative_to(ROOT).as_posix()
    if file.suffix == ".md":
        return f"source/{name}", file.read_text(encoding="utf-8")
    return (
        f"source/{name}.md",
        f"# {name}\n\n````{file.suffix[1:]}\n{file.read_text(encoding='utf-8')}\n````\n",
    )


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the pages that are made here."""

    def add(uri: str, content: str) -> None:
        if uri not in files.src_uris:
            files.append(File.generated(config, uri, content=content))

    for package in packages():
        add(f"api/{package.name}.md", api_page(package))
    for name in ("CHANGELOG.md", "CONTRIBUTING.md"):
        add(f"project/{name}", (ROOT / name).read_text(encoding="utf-8"))
    for page in [*files.documentation_pages()]:
        for match in LINK.finditer(page.content_string if page.src_uri.endswith(".md") else ""):
            file = outside_file(page.src_uri, match["path"])
            if file is not None:
                add(*source_page(file))
    return files


def on_config(config: MkDocsConfig) -> MkDocsConfig:
    """Put the API's pages into the navigation."""
    for entry in config.nav or []:
        if "API" in entry:
            entry["API"] = [{f"modpush.{p.name}": f"api/{p.name}.md"} for p in packages()]
    return config


def on_page_markdown(markdown: str, page: Page, **_: Any) -> str:
    """Turn links to files outside of `docs/` into links to their pages."""

    def replace(match: re.Match[str]) -> str:
        file = outside_file(page.file.src_uri, match["path"])
        if file is None:
            return match[0]
        address = os.path.relpath(source_page(file)[0], Path(page.file.src_uri).parent)
        return f"]({address}{match['anchor'] or ''})"

    return LINK.sub(replace, markdown)
