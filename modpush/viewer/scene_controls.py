"""The parts of the panel that change the running scene: policy, goal, obstacles, and the hand."""

import functools
from typing import Any

from modpush.viewer.edits import OBSTACLE_SIZES
from modpush.viewer.panel import Panel
from modpush.viewer.policies import POLICIES

__all__ = ["HandControls", "PolicyControls", "SceneControls"]

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
        chosen = (self._first.value, self._second.value)
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
        self.selected: int | None = None
        """The obstacle that was clicked last."""
        with panel.gui.add_folder("Goal and obstacles"):
            panel.gui.add_markdown(
                "Drag the goal and the obstacles. Shift-drag turns an obstacle or a goal pose, a click "
                "selects an obstacle."
            )
            self._goal = panel.field(
                panel.gui.add_vector2("Goal [m]", self._goal_now(), step=0.01),
                lambda goal: session.move_goal(*goal),
            )
            for kind in OBSTACLE_SIZES:
                panel.button(f"Add a {kind}", functools.partial(session.add_obstacle, kind))
            panel.button("Remove the selected obstacle", self._remove, "delete")

    def _goal_now(self) -> tuple[float, float]:
        x, y = self._session.snapshots[0].scenario.goal_position
        return round(x, 3), round(y, 3)

    def select(self, index: int) -> None:
        """Take an obstacle as the one that is meant."""
        self.selected = index

    def _remove(self) -> None:
        if self.selected is None:
            raise ValueError("Click an obstacle to select it.")
        index, self.selected = self.selected, None
        self._session.remove_obstacle(index)

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
