"""Check that a release's tag, the version and the changelog agree, and print the release's notes.

    python tools/check_release.py v0.1.0

The version is `__version__` in `modpush/__init__.py`; `CHANGELOG.md` must have a section
`## 0.1.0 (2030-01-31)` and nothing under "Unreleased".
"""

import re
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]


def release_notes(tag: str, root: Path = ROOT) -> str:
    """The changelog's section of a release.

    Args:
        tag: The release's tag, `v` and the version.
        root: Folder of the repository.

    Raises:
        ValueError: If tag, version and changelog do not agree.
    """
    source = (root / "modpush" / "__init__.py").read_text(encoding="utf-8")
    (version,) = re.findall(r'^__version__ = "([^"]+)"$', source, re.MULTILINE)
    if tag != f"v{version}":
        raise ValueError(
            f"tag must be 'v{version}', the version in modpush/__init__.py, got {tag!r}."
        )
    parts = re.split(
        r"^## (.+)\n", (root / "CHANGELOG.md").read_text(encoding="utf-8"), flags=re.MULTILINE
    )
    sections = dict(zip(parts[1::2], parts[2::2], strict=True))
    if sections.get("Unreleased", "").strip():
        raise ValueError(f"CHANGELOG.md: 'Unreleased' must be empty, give it to {version}.")
    for title, text in sections.items():
        if re.fullmatch(rf"{re.escape(version)} \(\d{{4}}-\d\d-\d\d\)", title) and text.strip():
            return text.strip()
    raise ValueError(
        f"CHANGELOG.md: expected a section '## {version} (YYYY-MM-DD)', got {[*sections]}."
    )


if __name__ == "__main__":
    if len(sys.argv) != 2:
        sys.exit(__doc__)
    try:
        print(release_notes(sys.argv[1]))
    except ValueError as error:
        sys.exit(f"check_release: {error}")
