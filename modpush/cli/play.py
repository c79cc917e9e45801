"""Push in the browser, at `http://127.0.0.1:8080`, without a GPU or a renderer.

Drag the goal and the obstacles while a policy or the keyboard moves the arm.
"""

from collections.abc import Sequence

from modpush._extras import require_extra
from modpush.cli.options import parse_options

__all__ = ["main"]


def main(arguments: Sequence[str]) -> None:
    """`modpush play <arguments>`."""
    require_extra("modpush play", "viser")
    from modpush.viewer import PlayConfig, play

    play(parse_options(PlayConfig, "modpush play", __doc__, arguments))
