"""`Controls`: the panel beside the scene."""

from typing import TYPE_CHECKING, Any

import numpy as np

from modpush.viewer.episode_controls import EpisodeControls, TimeControls
from modpush.viewer.overlays import Overlays, window_picture
from modpush.viewer.panel import Panel, assign
from modpush.viewer.scene_controls import HandControls, PolicyControls, SceneControls
from modpush.viewer.session import Session

if TYPE_CHECKING:
    from viser import ViserServer

__all__ = ["Controls"]

_OVERLAYS = {
    "path": "Planned path",
    "subgoal": "Sub-goal",
    "flags": "Contacts and collisions",
    "map": "Inflated map",
    "window": "Window and reconstruction",
}
_STORED = ("path", "subgoal", "flags")  # what an evaluation keeps of an episode


class Controls:
    """Turns what is clicked into commands of the session, and shows how it stands.

    Args:
        server: The page.
        session: What runs behind it.
    """

    def __init__(self, server: "ViserServer", session: Session) -> None:
        self._session = session
        self.overlays = Overlays()
        # No share button: it would ask a stranger's machine to pass the page on.
        server.gui.configure_theme(show_logo=False, show_share_button=False)
        server.gui.main_panel.dock_right()
        gui, panel = server.gui, Panel(server.gui, session)
        self._status = gui.add_markdown("")
        self.scene: SceneControls | None = None
        tabs = gui.add_tab_group()
        with tabs.add_tab("Run"):
            self.time = TimeControls(panel)
            self._parts: list[Any] = [self.time, EpisodeControls(panel)]
            if not session.replaying:
                self._parts.append(PolicyControls(panel))
        if not session.replaying:
            with tabs.add_tab("Scene"):
                self.scene = SceneControls(panel)
                self._parts.append(self.scene)
                HandControls(panel)
        with tabs.add_tab("Overlays"):
            self._add_overlays(server)

    def _add_overlays(self, server: "ViserServer") -> None:
        for field, label in _OVERLAYS.items():
            if not self._session.replaying or field in _STORED:
                shown = getattr(self.overlays, field)
                server.gui.add_checkbox(label, shown).on_update(self._switch(field))
        empty = np.zeros((8, 16, 3), dtype=np.uint8)
        self._images = [server.gui.add_image(empty, visible=False) for _ in range(2)]

    def _switch(self, field: str) -> Any:
        def switch(event: Any) -> None:
            setattr(self.overlays, field, event.target.value)

        return switch

    @property
    def selected(self) -> int | None:
        """The obstacle that was clicked last."""
        return None if self.scene is None else self.scene.selected

    def select(self, index: int) -> None:
        """Take an obstacle as the one that is meant."""
        if self.scene is not None:
            self.scene.select(index)

    def update(self) -> None:
        """Show how the session stands."""
        assign(self._status, "content", self._status_text())
        for part in self._parts:
            part.update()
        for i, image in enumerate(self._images):
            window = self._session.snapshots[i].window if i < len(self._session.snapshots) else None
            shown = self.overlays.window and window is not None
            assign(image, "visible", shown)
            if shown and window is not None:
                image.image = window_picture(window, self._session.lanes[i].reconstruction())
                lane = self._session.lanes[i]
                assign(image, "label", f"{lane.name}: window, and what the autoencoder keeps")

    def _status_text(self) -> str:
        """A line for each lane, and why the last command failed, as Markdown."""
        lines = []
        for name, shown in zip(self._session.names, self._session.snapshots, strict=True):
            end = "running"
            if shown.flags["success"]:
                end = "**success**"
            elif shown.flags["out_of_bounds"]:
                end = "**out of bounds**"
            value = "" if shown.value is None else f", critics expect {shown.value:.1f}"
            lines.append(f"{name}: {end}, step {shown.step}{value}")
        if self._session.paused:
            lines.append("*paused*")
        if self._session.message:
            lines.append(f"**{self._session.message}**")
        return "  \n".join(lines)
