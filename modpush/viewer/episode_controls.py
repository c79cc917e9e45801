"""The parts of the panel for time and episode."""

from typing import Any

from modpush.envs.scenes.layouts import ALL_SCENES
from modpush.envs.scenes.objects import OBJECTS
from modpush.viewer.panel import Panel, assign
from modpush.viewer.session import Session

__all__ = ["EpisodeControls", "TimeControls"]

_SPEEDS = ("0.25", "0.5", "1", "2", "4")


def _scenes(session: Session) -> tuple[str, ...]:
    """Names of the scene families, with one's own if the page was started with one."""
    return tuple(dict.fromkeys((*ALL_SCENES, session.scene)))


class TimeControls:
    """Pause, single step, speed and recording."""

    def __init__(self, panel: Panel) -> None:
        self._session = session = panel.session
        self.speed = 1.0
        """Speed as a multiple of real time."""
        with panel.gui.add_folder("Time"):
            self._paused = panel.field(
                panel.gui.add_checkbox("Pause", session.paused), session.set_paused
            )
            panel.button("Single step", session.step_once, "N")
            speed = panel.gui.add_dropdown("Speed", _SPEEDS, initial_value="1")
            speed.on_update(self._set_speed)
            panel.field(
                panel.gui.add_checkbox("Continue after the end", session.auto_continue),
                session.set_auto_continue,
            )
            self._record = panel.button("Record a video", self._toggle_recording)

    def _set_speed(self, event: Any) -> None:
        self.speed = float(event.target.value)

    def _toggle_recording(self) -> None:
        if self._session.recorder is None:
            self._session.start_recording()
        else:
            self._session.stop_recording()

    def update(self) -> None:
        """Show the session's state."""
        self._paused.show(self._session.paused)
        recording = self._session.recorder is not None
        assign(self._record, "label", "Stop recording" if recording else "Record a video")


class EpisodeControls:
    """Choice of the episode: seed, scene family, difficulty and object."""

    def __init__(self, panel: Panel) -> None:
        self._session = session = panel.session
        gui = panel.gui
        with gui.add_folder("Episode"):
            self._seed = panel.field(
                gui.add_number(
                    "Stored episode" if session.replaying else "Seed", session.seed, min=0, step=1
                ),
                lambda seed: session.reset(int(seed)),
            )
            if not session.replaying:
                self._scene = panel.field(
                    gui.add_dropdown("Scene", _scenes(session), initial_value=session.scene),
                    lambda name: session.choose_scene(scene=name),
                )
                self._difficulty = panel.field(
                    gui.add_slider("Difficulty", 0.0, 1.0, 0.05, session.difficulty),
                    lambda value: session.choose_scene(difficulty=float(value)),
                )
                self._object = panel.field(
                    gui.add_dropdown("Object", tuple(OBJECTS), initial_value=session.pushed_object),
                    lambda name: session.choose_scene(pushed_object=name),
                )
            panel.button("Reset to the seed", session.reset, "R")
            panel.button("Again as changed", session.restart, "B")
            panel.button("Next episode", session.next_episode, "M")

    def update(self) -> None:
        """Show the session's state."""
        session = self._session
        self._seed.show(session.seed)
        if not session.replaying:
            self._scene.show(session.scene)
            self._difficulty.show(session.difficulty)
            self._object.show(session.pushed_object)
