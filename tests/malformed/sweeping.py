"""Sweeps and the paper's tables, with right arguments."""

import math
from pathlib import Path
from typing import Any

import pandas as pd

from modpush import reproduction, sweeps
from modpush.evaluation.stats import PairedTest
from modpush.sweeps.definition import Trial
from modpush.training import TRAIN_PRESETS
from tests.malformed.files import folder, good
from tests.malformed.target import BELOW_1, NOT_FINITE, UNKNOWN, Target

SMOKE = Path(__file__).parents[2] / "examples" / "sweeps" / "smoke.yaml"


def targets() -> list[Target]:
    """All of them."""
    return [*_definitions(), *_runs(), *_reproduction()]


def _sweep() -> sweeps.Sweep:
    variants = (sweeps.Variant(name="a", group="x"), sweeps.Variant(name="b", group="y"))
    return sweeps.Sweep(preset="smoke", variants=variants)


def _trials() -> tuple[Trial, ...]:
    return _sweep().trials()


def _definitions() -> list[Target]:
    copied = folder() / "sweep" / "smoke.yaml"
    copied.parent.mkdir(exist_ok=True)
    copied.write_bytes(SMOKE.read_bytes())
    config = TRAIN_PRESETS["smoke"][1]
    wrong: list[Any] = [
        {"no such": 1},
        {"env.no_such": 1},
        {"no_such.env": 1},
        {"env.encoder": 3},
        {"tqc.tau": math.nan},
        {"seed": object()},
        {3: 1},
        3,
        None,
    ]
    return [
        Target(
            name="load_sweep",
            call=sweeps.load_sweep,
            given=lambda: {"source": copied},
            bad={
                "source": [
                    good("agent"),
                    "no such",
                    "no_module:thing",
                    "modpush.sweeps:NoSuch",
                    "os:getcwd",
                    "modpush.planners:PLANNERS",
                    3,
                    None,
                    folder(),
                ]
            },
            only=["source"],  # a seal is not asked for: people write these files
            also={"source": ["load_sweep"]},
        ),
        Target(
            name="override",
            call=sweeps.override,
            given=lambda: {"config": config, "overrides": {"seed": 1}, "who": "it"},
            bad={"config": [None, 3, {}], "overrides": wrong, "who": [3, None]},
            only=["config", "overrides", "who"],
            also={"overrides": ["TrainConfig", "encoder", "tau", "no such", "env", "it"]},
        ),
        Target(
            name="Sweep.of_groups",
            call=_sweep().of_groups,
            given=lambda: {"groups": ("x",)},
            bad={"groups": [("z",), 3, (3,), None, "x"]},
            only=["groups"],
        ),
        Target(
            name="Sweep.trials",
            call=_sweep().trials,
            given=lambda: {"total_steps": 8},
            bad={"total_steps": [*BELOW_1, "3", 1.5]},
        ),
        Target(
            name="Sweep(contradictory)",
            call=lambda fields: sweeps.Sweep(**{"variants": _sweep().variants, **fields}),
            given=lambda: {"fields": {}},
            bad={
                "fields": [
                    {"preset": "no such"},
                    {"seeds": (1, 1)},
                    {"variants": (sweeps.Variant(name="a"),) * 2},
                    {"variants": ()},
                ]
            },
            only=["fields"],
            also={"fields": ["preset", "seeds", "variants"]},
        ),
    ]


def _runs() -> list[Target]:
    place = folder() / "swept"
    return [
        Target(
            name="run_sweep",
            call=sweeps.run_sweep,
            given=lambda: {
                "sweep": _sweep(),
                "folder": place,
                "ray": False,
                "total_steps": 8,
                "progress": False,
            },
            bad={
                "sweep": [None, 3, "smoke.yaml", [], _trials()],
                "folder": [good("agent"), 3, None],
                "ray": [None, "yes", 2],
                "total_steps": [*BELOW_1, "3", 1.5],
                "progress": [None, "yes", 2],
            },
            only=["sweep", "folder", "ray", "total_steps", "progress"],
        ),
        *(
            Target(
                name=function.__name__,
                call=function,
                given=lambda: {"trials": _trials(), "folder": place},
                bad={"trials": [3, None, "ab", (3,), _sweep()], "folder": [3, None]},
                only=["trials", "folder"],
            )
            for function in (sweeps.sweep_results, sweeps.sweep_curves)
        ),
    ]


def _reproduction() -> list[Target]:
    test = PairedTest(count=4, difference=0.1, t=2.0, p=0.1, effect_size=1.0)
    cell = pd.Series({"mean": 0.5, "low": 0.4, "high": 0.6, "count": 10})
    config = reproduction.ReproduceConfig
    return [
        Target(
            name="against_method",
            call=reproduction.against_method,
            given=lambda: {"metric": "spl", "test": test},
            bad={"test": [None, 3, "ahead", cell]},
            only=["test"],
        ),
        Target(
            name="against_printed",
            call=reproduction.against_printed,
            given=lambda: {"metric": "spl", "cell": cell, "printed": 0.5, "printed_runs": 50},
            bad={
                "metric": [3, None],
                "cell": [None, 3, {}, cell.drop("mean"), cell * 0],
                "printed": NOT_FINITE,
                "printed_runs": BELOW_1[1:],
            },
            only=["metric", "cell"],
        ),
        Target(
            name="reproduce",
            call=reproduction.reproduce,
            given=lambda: {"config": config(parts=("ablations",))},
            bad={"config": [None, 3, {}, "all", ("free",)]},
            only=["config"],
        ),
        Target(
            name="reproduce(agent)",
            call=lambda agent: reproduction.reproduce(
                config(
                    parts=("free",),
                    agent=agent,
                    rows=folder() / "rows",
                    out=folder() / "pages",
                    progress=False,
                )
            ),
            given=lambda: {"agent": "small_cube"},
            bad={"agent": [*UNKNOWN, str(good("trajectory")), 3, None]},
            only=["agent"],
            also={"agent": ["trajectory.npz", *UNKNOWN[1:]]},
        ),
        Target(
            name="reproduce(sweep)",
            call=lambda sweep: reproduction.reproduce(
                config(parts=("ablations",), sweep=sweep, rows=folder() / "rows")
            ),
            given=lambda: {"sweep": folder() / "none"},
            bad={"sweep": [folder() / "none", good("agent"), 3]},
            only=["sweep"],
        ),
    ]
