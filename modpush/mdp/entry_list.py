"""Choice of the entries of an observation, and the latent relative to that of an empty window."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import torch
from torch import Tensor, nn

from modpush._validation import checked_arguments
from modpush.geometry.frames import Frame
from modpush.mdp.observation_entries import (
    ENTRIES,
    PAPER_ENTRIES,
    PATH_ENTRIES,
    Entry,
    EntryLike,
)
from modpush.parts import find_part


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


@checked_arguments
def latent_entry(encoder: nn.Module) -> Entry:
    """The latent minus the encoder's latent of an empty window, so that free space gives zeros.

    Args:
        encoder: Module `[B, 1, S, S] -> [B, d]`; its `window_size` S is 64 unless it defines another.
    """
    latent = ENTRIES["latent"]
    return replace(latent, shift=BlankLatent(encoder))


class BlankLatent:
    """The latent of an empty window, `[d]`, by an encoder that is shared, not copied.

    It is computed at the first call, on the encoder's device and in evaluation mode, and again once
    the weights have been changed in place, trained or moved; not after `load_state_dict(assign=True)`,
    which puts others in their place. The encoder's training flags stay as they are.
    """

    def __init__(self, encoder: nn.Module) -> None:
        self.encoder = encoder
        self._find_weights()
        self._versions: list[int] = []
        self._last_before = torch.empty(0, device="cpu")
        self._latent: Tensor | None = None

    def _find_weights(self) -> None:
        """Note the tensors that tell whether the encoder has changed."""
        encoder = self.encoder
        # Walking through the modules at every observation would take longer than the observation.
        weights: list[Tensor] = [*encoder.parameters(), *encoder.buffers()]
        self._versioned = [weight for weight in weights if not weight.is_inference()]
        # Fused optimizers change weights without a new version, but then all that they train.
        parameters: list[Tensor] = list(encoder.parameters())
        self._has_parameters = bool(parameters)
        trained = [weight for weight in parameters if weight.requires_grad]
        self._last = (trained or parameters or weights or [torch.empty(0, device="cpu")])[-1]

    def __call__(self) -> Tensor:
        """The latent, `[d]`; the same tensor until the weights change."""
        if not self._has_parameters:
            self._find_weights()  # moving a module puts others in the places of its buffers
        versions = [weight._version for weight in self._versioned]
        if self._latent is None or versions != self._versions or not self._last_is_as_before():
            self._latent, self._versions = self._encode(), versions
            self._last_before = self._last.detach().clone()
        return self._latent

    def _last_is_as_before(self) -> bool:
        now, before = self._last, self._last_before
        alike = now.device == before.device and now.dtype == before.dtype
        return alike and torch.equal(now, before)

    @torch.no_grad()
    def _encode(self) -> Tensor:
        size = int(getattr(self.encoder, "window_size", 64))
        device = self._last.device
        training = [module for module in self.encoder.modules() if module.training]
        self.encoder.eval()
        try:
            blank = torch.zeros(1, 1, size, size, dtype=torch.float32, device=device)
            return self.encoder(blank)[0]
        finally:
            for module in training:  # those, and none that were frozen on purpose
                module.training = True
