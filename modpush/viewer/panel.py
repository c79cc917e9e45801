"""Buttons and fields that send commands to the session, for all folders of the panel."""

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

from modpush.viewer.session import Session

if TYPE_CHECKING:
    from viser import GuiApi


def assign(handle: Any, field: str, value: Any) -> None:
    """Assign only what differs: every assignment is a message to every tab."""
    now = getattr(handle, field)
    if now is None or not np.array_equal(now, value):
        setattr(handle, field, value)


class Panel:
    """Makes the elements of the panel.

    Args:
        gui: The panel to which they are added.
        session: The session that carries out their commands.
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

    def field(self, handle: Any, command: Callable[[Any], object]) -> "Field":
        """Send a command with each value that a person sets in an element."""
        return Field(self.session, handle, command)


class Field:
    """An element that shows a value of the session and lets a person set it.

    Args:
        session: The session that carries out the command.
        handle: The element.
        command: Called with what a person has set.
    """

    def __init__(self, session: Session, handle: Any, command: Callable[[Any], object]) -> None:
        self._session, self._handle, self._command = session, handle, command
        self._shown: Any = handle.value
        handle.on_update(self._on_update)

    # `async`, since viser then calls it before anything else can change the value.
    async def _on_update(self, event: Any) -> None:
        if event.client is not None:  # None: `show` has set it
            value = self._handle.value
            self._session.submit(lambda: self._set(value), key=id(self))

    def _set(self, value: Any) -> None:
        try:
            self._command(value)
        finally:
            self._shown = None  # a value that is refused is taken back

    def show(self, value: Any) -> None:
        """Show the session's value where it has changed.

        It is not compared with the element's own, which a person may just have set.
        """
        if self._shown is None or not np.array_equal(self._shown, value):
            self._shown = value
            self._handle.value = value
