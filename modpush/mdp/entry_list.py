"""Choice of the entries of an observation."""

from collections.abc import Mapping, Sequence

from modpush._arguments import checked_arguments
from modpush.geometry.frames import Frame
from modpush.mdp.observation_entries import (
    ENTRIES,
    PAPER_ENTRIES,
    PATH_ENTRIES,
    Entry,
    EntryLike,
)
from modpush.parts import find_part

__all__ = ["resolve_entries"]


@checked_arguments
def resolve_entries(
    frame: Frame,
    entries: Mapping[str, EntryLike] | Sequence[EntryLike | tuple[str, EntryLike]] | None = None,
    *,
    leave_out: Sequence[str] = (),
    add: Sequence[EntryLike | tuple[str, EntryLike]] = (),
) -> dict[str, Entry]:
    """The entries of an observation by name, in their order.

    An entry without a name of its own is called by the name of its function: `"my_module:speed"`
    becomes `"speed"`.

    Args:
        frame: The agent's axes, for the default entries.
        entries: The entries to start from; `PATH_ENTRIES` in the path's frame and `PAPER_ENTRIES`
            in others by default.
        leave_out: Names of entries to leave out, for an ablation.
        add: Entries to append.

    Raises:
        ValueError: If there is no such entry, something is neither text, an `Entry` nor a function,
            nothing is left, an entry to leave out is not among the entries, or two entries have one
            name.
        TypeError: If what a text names is neither an `Entry` nor a function.
    """
    if entries is None:
        entries = PATH_ENTRIES if frame == "path" else PAPER_ENTRIES
    items = list(entries.items()) if isinstance(entries, Mapping) else list(entries)
    found: dict[str, Entry] = {}
    for item in [*items, *add]:
        if isinstance(item, str) and item in ENTRIES:
            name, entry = item, ENTRIES[item]
        else:
            ready = isinstance(item, tuple) and isinstance(item[1], Entry)
            name, entry = item if ready else _find_entry(item)
        if name in found:
            raise ValueError(
                f"PushObservation: entries must have different names, got {name!r} twice."
            )
        found[name] = entry
    if unknown := sorted(set(leave_out) - set(found)):
        raise ValueError(
            f"PushObservation: cannot leave out {unknown}, the entries are {list(found)}."
        )
    found = {name: entry for name, entry in found.items() if name not in leave_out}
    if not found:
        raise ValueError("PushObservation: entries is empty, expected at least one.")
    return found


def _find_entry(item: EntryLike | tuple[str, EntryLike]) -> tuple[str, Entry]:
    name, part = item if isinstance(item, tuple) else (None, item)
    found = find_part("entries", part, ENTRIES)
    if not isinstance(found, Entry) and not callable(found):
        raise TypeError(
            "PushObservation: an entry must be a name, 'module:name', an Entry or a function, got "
            f"{found!r}."
        )
    entry = found if isinstance(found, Entry) else Entry(found)
    if name is None and isinstance(part, str):
        name = part.rpartition(":")[2].rpartition(".")[2]
    elif name is None:
        name = getattr(entry.read, "__name__", "<")
        if "<" in name:  # a lambda
            raise ValueError(
                "PushObservation: an entry of your own needs a name: give ('name', entry), got "
                f"{entry.read!r} alone."
            )
    return name, entry
