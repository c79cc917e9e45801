"""The page's session and the command lines, with right arguments."""

import functools
from typing import Any

from modpush.cli import RunConfig
from modpush.cli.demo import DemoConfig
from modpush.cli.evaluate import EvaluateConfig
from modpush.cli.export import ExportConfig
from modpush.viewer import PlayConfig, Session
from tests.malformed.files import folder, good
from tests.malformed.target import NOT_FINITE, UNKNOWN, Target


def targets() -> list[Target]:
    """All of them."""
    return [*_viewer(), *_commands()]


@functools.cache
def session() -> Session:
    """One policy in the free family."""
    return Session(PlayConfig(policy=("hand",), scene="slot"))


def _viewer() -> list[Target]:
    kept = session()
    return [
        Target(
            name="Session",
            call=lambda **given: Session(PlayConfig(**given)),
            given=lambda: {"policy": ("hand",), "replay": ()},
            bad={
                "policy": [(), ("no such",), ("hand",) * 3, 3],
                "replay": [(folder() / "none",), (3,), 3, (good("agent"),)],
            },
            only=["policy", "replay"],
            also={"replay": ["ReplayLane"]},
        ),
        Target(
            name="Session.choose_scene",
            call=kept.choose_scene,
            given=lambda: {"scene": "free", "difficulty": 0.2, "pushed_object": "small_cube"},
            bad={
                "scene": UNKNOWN,
                "difficulty": [-0.1, 1.5, *NOT_FINITE],
                "pushed_object": UNKNOWN,
            },
        ),
        Target(
            name="Session.choose_policies",
            call=lambda policies: kept.choose_policies(*policies),
            given=lambda: {"policies": ("hand",)},
            bad={"policies": [(), ("no such",), ("hand",) * 3, (3,)]},
            only=["policies"],
            also={"policies": ["policy", "no such"]},
        ),
        Target(
            name="Session.move_goal",
            call=kept.move_goal,
            given=lambda: {"x": 0.5, "y": 0.0},
            bad={"x": NOT_FINITE, "y": NOT_FINITE},  # what lies far away is put at the border
        ),
        Target(
            name="Session.move_obstacle",
            call=kept.move_obstacle,
            given=lambda: {"index": 0, "x": 0.5, "y": 0.0, "yaw": 0.0},
            bad={"index": [-1, 99], "x": NOT_FINITE, "y": NOT_FINITE, "yaw": NOT_FINITE},
            also=dict.fromkeys(("index", "x", "y", "yaw"), ("obstacle", "pose")),
        ),
        Target(
            name="Session.remove_obstacle",
            call=kept.remove_obstacle,
            given=lambda: {"index": 0},
            bad={"index": [-1, 99]},
            also={"index": ["obstacle"]},
        ),
        Target(
            name="Session.add_obstacle",
            call=kept.add_obstacle,
            given=lambda: {"kind": "cube"},
            bad={"kind": UNKNOWN},
        ),
        Target(
            name="Session.reset",
            call=kept.reset,
            given=lambda: {"seed": 0},
            bad={"seed": [-1, -5]},
        ),
    ]


def _commands() -> list[Target]:
    import contextlib
    import io

    import tyro

    def parse(kind: Any, **given: Any) -> Any:
        arguments = [part for name, value in given.items() for part in (f"--{name}", str(value))]
        out = io.StringIO()
        try:
            with contextlib.redirect_stderr(out), contextlib.redirect_stdout(out):
                return tyro.cli(kind, args=[part for part in arguments if part != ""])
        except SystemExit:
            text = " ".join(out.getvalue().replace("│", " ").split())
            raise ValueError(text) from None

    wrong = ["", "abc", "-1", "nan", "1e400", "[]"]
    given: dict[Any, dict[str, Any]] = {
        RunConfig: {"train.seed": 0, "train.tqc.tau": 0.1, "train.env.num-envs": 4},
        EvaluateConfig: {"num-envs": 4, "workers": 1, "episodes": 2},
        DemoConfig: {"episodes": 1, "difficulty": 0.5, "seed": 0},
        PlayConfig: {"difficulty": 0.5, "port": 8080},
        ExportConfig: {"format": "onnx"},
    }
    return [
        Target(
            name=f"command line of {kind.__name__}",
            call=functools.partial(parse, kind),
            given=lambda right=right: dict(right),
            bad=dict.fromkeys(right, wrong),
            only=list(right),
            also={name: [name.rpartition(".")[2].replace("-", "_"), "formats"] for name in right},
        )
        for kind, right in given.items()
    ]
