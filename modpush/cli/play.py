"""Push in the browser, at `http://127.0.0.1:8080`, without a GPU or a renderer.

Drag the goal and the obstacles while a policy or the keyboard moves the arm.

Options:
  --policy NAME [NAME]  One policy, or two that are shown side by side on the same scene: agent (the
                        shipped one for all objects), a shipped agent by its name, corridor,
                        corridor_faithful, scripted, hand, an agent's file, or a training run's
                        folder; by default agent.
  --scene NAME          Scene family from which episodes are drawn; by default slot.
  --pushed-object NAME  Object that is pushed; by default small_cube.
  --goal {position,pose}
                        Goals of the episodes: positions or poses of the object; by default position.
  --difficulty X        Difficulty of the scenes, 0 to 1; by default 0.3.
  --engine NAME         Physics engine: sapien, mujoco, or module:name; by default an agent's own.
  --robot NAME          Arm: ur5, ur10, ... or module:name; by default an agent's own.
  --tool NAME           Tool of the arm: 2f85, rod, or module:name; by default an agent's own.
  --seed N              Seed of the first episode; by default 0.
  --paused              Start paused.
  --host ADDRESS        Address to listen on. The default, 127.0.0.1, can be reached from this machine
                        only. The page has no password: anyone who reaches it can use it.
  --port N              Port to listen on; if it is taken, the next free one is used and printed; by
                        default 8080.
  --allow MODULE ...    Modules from which the file of an agent or a run may import its author's own
                        parts.
"""

from collections.abc import Sequence

import tyro

from modpush._extras import require_extra


def main(arguments: Sequence[str]) -> None:
    """`modpush play <arguments>`."""
    require_extra("modpush play", "viser")
    from modpush.viewer import PlayConfig, play

    play(tyro.cli(PlayConfig, prog="modpush play", args=[*arguments]))
