"""`CommandQueue`: what other threads want done, in order."""

import queue
from collections.abc import Callable, Hashable

Command = Callable[[], object]


class CommandQueue:
    """Commands that threads hand over, carried out by one thread."""

    def __init__(self) -> None:
        self._waiting: queue.SimpleQueue[tuple[Hashable, Command]] = queue.SimpleQueue()

    def put(self, command: Command, key: Hashable = None) -> None:
        """Add a command.

        Args:
            command: The command.
            key: Of waiting commands with the same key, such as the moves of one drag, only the last
                is carried out.
        """
        self._waiting.put((key, command))

    def take(self) -> list[Command]:
        """All waiting commands in their order, without those that a later one replaces."""
        found: list[tuple[Hashable, Command]] = []
        while not self._waiting.empty():
            found.append(self._waiting.get())
        last = {key: i for i, (key, _) in enumerate(found)}
        return [command for i, (key, command) in enumerate(found) if key is None or last[key] == i]
