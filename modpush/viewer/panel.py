"""What every part of the panel needs: buttons and fields that send commands to the session."""

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

from modpush.viewer.session import Session

if TYPE_CHECKING:
    from viser import GuiApi

__all__ = ["Panel", "assign"]


def assign(handle: Any, field: str, value: Any) -> None:
    """Assign only what differs: every assignment is a message to every tab."""
    now = getattr(handle, field)
    if now is None or not np.array_equal(now, value):
        setattr(handle, field, value)


class Panel:
    """Makes the elements of the panel.

    Args:
        gui: Where they are added.
        session: What carries out their commands.
    """

    def __init__(self, gui: "GuiApi", session: Session) -> None:
        self.gui, self.session = gui, session

    def button(self, label: str, command: Callable[[], object], hotkey: str | None = None) -> Any:
        """A button, and a key that does the same."""
        button = self.gui.add_button(label if hotkey is None else f"{label} ({hotkey})")
        button.on_click(lambda _: self.session.submit(command))
        if hotkey is not None:
            self.hotkey(label, hotkey, command)
        return button

    def hotkey(self, label: str, hotkey: Any, command: Callable[[], object]) -> None:
        """A key that sends a command."""
        self.gui.add_command(label, hotkey=hotkey).on_trigger(
            lambda _: self.session.submit(command)
        )

    def on_change(self, handle: Any, command: Callable[[Any], object]) -> Any:
        """Send a command with each value that a person sets; returns the element."""

        @handle.on_update
        def _(event: Any) -> None:
            if event.client is not None:  # None: `update` has set the value
                value = handle.value
                self.session.submit(lambda: command(value), key=id(handle))

        return handle
