"""The panel beside the scene: its buttons and fields, which send commands to the session."""

import functools
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

from modpush.envs.scenes.layouts import ALL_SCENES
from modpush.envs.scenes.objects import OBJECTS
from modpush.viewer.lane import POLICIES
from modpush.viewer.overlays import Overlays
from modpush.viewer.session import Session

if TYPE_CHECKING:
    from viser import GuiApi, ViserServer


def assign(handle: Any, field: str, value: Any) -> None:
    """Assign only what differs: every assignment is a message to every tab."""
    now = getattr(handle, field)
    if now is None or not np.array_equal(now, value):
        setattr(handle, field, value)


class Panel:
    """Makes the elements of the panel, whose commands a session carries out."""

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
    """An element that shows a value of the session and calls a command with what a person sets."""

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
        """Show the session's value where it, not the element's own, has changed."""
        if self._shown is None or not np.array_equal(self._shown, value):
            self._shown = value
            self._handle.value = value


_NONE = "none"
_MOVES = {
    "away": ("I", (1.0, 0.0, 0.0)),
    "towards": ("K", (-1.0, 0.0, 0.0)),
    "left": ("J", (0.0, 1.0, 0.0)),
    "right": ("L", (0.0, -1.0, 0.0)),
    "turn left": ("U", (0.0, 0.0, 1.0)),
    "turn right": ("O", (0.0, 0.0, -1.0)),
}
"""Key and action of each move by hand, seen from the robot."""


class PolicyControls:
    """Choice of the policy, and of a second one beside it."""

    def __init__(self, panel: Panel) -> None:
        self._session, gui = panel.session, panel.gui
        names, policies = self._names(), self._session.policies
        with gui.add_folder("Policy"):
            self._first = gui.add_dropdown("Policy", names, initial_value=policies[0])
            self._second = gui.add_dropdown(
                "Beside it", (_NONE, *names), initial_value=(*policies, _NONE)[1]
            )
            self._file: Any = gui.add_text(
                "Agent file", "", hint="File of an agent, or folder of a training run."
            )
            panel.button("Load the agent file", self._load)
        self._fields = [panel.field(handle, self._choose) for handle in (self._first, self._second)]

    def _names(self) -> tuple[str, ...]:
        return tuple(dict.fromkeys((*POLICIES, *self._session.policies)))

    def _choose(self, _: str) -> None:
        chosen = self._first.value, self._second.value
        self._session.choose_policies(*(name for name in chosen if name != _NONE))

    def _load(self) -> None:
        self._session.choose_policies(self._file.value, *self._session.policies[1:])

    def update(self) -> None:
        """Show which policies run, also after a choice that failed."""
        names, policies = self._names(), self._session.policies
        if not set(names) <= set(self._first.options):
            self._first.options, self._second.options = names, (_NONE, *names)
        for field, value in zip(self._fields, (*policies, _NONE)[:2], strict=True):
            field.show(value)


class SceneControls:
    """Goal and obstacles."""

    def __init__(self, panel: Panel) -> None:
        self._session = session = panel.session
        with panel.gui.add_folder("Goal and obstacles"):
            panel.gui.add_markdown(
                "Drag the goal and the obstacles. Shift-drag turns an obstacle or a goal pose."
            )
            self._goal = panel.field(
                panel.gui.add_vector2("Goal [m]", self._goal_now(), step=0.01),
                lambda goal: session.move_goal(*goal),
            )

    def _goal_now(self) -> tuple[float, float]:
        x, y = self._session.snapshots[0].scenario.goal_position
        return round(x, 3), round(y, 3)

    def update(self) -> None:
        """Show where the goal is."""
        self._goal.show(self._goal_now())


class HandControls:
    """Keys and buttons that move the tool, for the policy `hand`."""

    def __init__(self, panel: Panel) -> None:
        self._session = session = panel.session
        with panel.gui.add_folder("By hand"):
            keys = ", ".join(f"**{key}** {name}" for name, (key, _) in _MOVES.items())
            panel.gui.add_markdown(f"For the policy *hand*; seen from the robot. {keys}.")
            for names in (("left", "away", "towards", "right"), ("turn left", "turn right")):
                panel.gui.add_button_group("", names).on_click(self._press)
        for name, (key, action) in _MOVES.items():
            panel.hotkey(
                f"Move the tool: {name}", key, functools.partial(session.push_by_hand, *action)
            )

    def _press(self, event: Any) -> None:
        _, action = _MOVES[event.target.value]
        self._session.submit(functools.partial(self._session.push_by_hand, *action))


_SPEEDS = ("0.25", "0.5", "1", "2", "4")


class TimeControls:
    """Pause, single step and speed."""

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

    def _set_speed(self, event: Any) -> None:
        self.speed = float(event.target.value)

    def update(self) -> None:
        """Show the session's state."""
        self._paused.show(self._session.paused)


class EpisodeControls:
    """Choice of the episode: seed, scene family, difficulty and object."""

    def __init__(self, panel: Panel) -> None:
        self._session = session = panel.session
        gui = panel.gui
        with gui.add_folder("Episode"):
            seed = gui.add_number("Seed", session.seed, min=0, step=1)
            scenes = tuple(dict.fromkeys((*ALL_SCENES, session.scene)))  # and one's own
            scene = gui.add_dropdown("Scene", scenes, initial_value=session.scene)
            difficulty = gui.add_slider("Difficulty", 0.0, 1.0, 0.05, session.difficulty)
            objects = tuple(OBJECTS)
            item = gui.add_dropdown("Object", objects, initial_value=session.pushed_object)
            choose = session.choose_scene
            self._fields = {
                "seed": panel.field(seed, lambda value: session.reset(int(value))),
                "scene": panel.field(scene, lambda name: choose(scene=name)),
                "difficulty": panel.field(difficulty, lambda v: choose(difficulty=float(v))),
                "pushed_object": panel.field(item, lambda name: choose(pushed_object=name)),
            }
            panel.button("Reset to the seed", session.reset, "R")
            panel.button("Again as changed", session.restart, "B")
            panel.button("Next episode", session.next_episode, "M")

    def update(self) -> None:
        """Show the session's state."""
        for name, field in self._fields.items():
            field.show(getattr(self._session, name))


_OVERLAYS = {
    "path": "Planned path",
    "subgoal": "Sub-goal",
    "flags": "Contacts and collisions",
    "map": "Inflated map",
}


class Controls:
    """Turns clicks on the page into commands of the session, and shows its state."""

    def __init__(self, server: "ViserServer", session: Session) -> None:
        self._session = session
        self.overlays = Overlays()
        # No share button: it would ask a stranger's machine to pass the page on.
        server.gui.configure_theme(show_logo=False, show_share_button=False)
        server.gui.main_panel.dock_right()
        gui, panel = server.gui, Panel(server.gui, session)
        self._status = gui.add_markdown("")
        tabs = gui.add_tab_group()
        with tabs.add_tab("Run"):
            self.time = TimeControls(panel)
            self._parts: list[Any] = [self.time, EpisodeControls(panel), PolicyControls(panel)]
        with tabs.add_tab("Scene"):
            self._parts.append(SceneControls(panel))
            HandControls(panel)
        with tabs.add_tab("Overlays"):
            self._add_overlays(server)

    def _add_overlays(self, server: "ViserServer") -> None:
        for field, label in _OVERLAYS.items():
            shown = getattr(self.overlays, field)
            server.gui.add_checkbox(label, shown).on_update(self._switch(field))

    def _switch(self, field: str) -> Any:
        def switch(event: Any) -> None:
            setattr(self.overlays, field, event.target.value)

        return switch

    def update(self) -> None:
        """Show the session's state."""
        assign(self._status, "content", self._status_text())
        for part in self._parts:
            part.update()

    def _status_text(self) -> str:
        """A line for each lane, and the error of the last command, as Markdown."""
        lines = []
        for name, shown in zip(self._session.names, self._session.snapshots, strict=True):
            end = "running"
            if shown.flags["success"]:
                end = "**success**"
            elif shown.flags["out_of_bounds"]:
                end = "**out of bounds**"
            lines.append(f"{name}: {end}, step {shown.step}")
        if self._session.paused:
            lines.append("*paused*")
        if self._session.message:
            lines.append(f"**{self._session.message}**")
        return "  \n".join(lines)
