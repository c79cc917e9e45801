"""Push in the browser, at `http://127.0.0.1:8080`, without a GPU or a renderer.

Drag the goal and the obstacles while a policy or the keyboard moves the arm.
"""

from collections.abc import Sequence

import tyro

from modpush._extras import require_extra

__all__ = ["main"]


def main(arguments: Sequence[str]) -> None:
    """`modpush play <arguments>`."""
    require_extra("modpush play", "viser")
    from modpush.viewer import PlayConfig, play

    play(tyro.cli(PlayConfig, prog="modpush play", description=__doc__, args=[*arguments]))
