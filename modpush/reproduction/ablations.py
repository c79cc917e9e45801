"""What two sweeps say, each as one table and one figure: the ablations, and training in hard scenes."""

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd

from modpush._provenance import read_sessions, sources_text
from modpush.evaluation.stats import paired_t_test
from modpush.evaluation.tables import format_table
from modpush.files import write_text
from modpush.reproduction.config import ReproduceConfig
from modpush.sweeps.figure import draw_sweep

__all__ = ["ablation_table", "write_ablations", "write_further"]

_REACHED = 0.9  # success rate whose first step is given
_TESTED = 3  # seeds from which on there is a test: two that happen to differ alike would give p = 0


@dataclass(frozen=True, kw_only=True)
class _SweepPage:
    """A page that is made of a sweep."""

    part: str
    sweep: str
    """The file that says what is run."""
    title: str
    about: str
    """The first sentences, with `{steps}` and `{minutes}`."""
    start: str = ""
    """The command that trains what the sweep starts from, if it does not start from random weights."""


_ABLATIONS = _SweepPage(
    part="ablations",
    sweep="examples/sweeps/ablations.yaml",
    title="What the parts of the method are worth",
    about="""Every variant is trained alike, {steps} environment steps ({minutes:.0f} minutes on average),
and evaluated without exploration noise on the same held-out episodes, which belong to no evaluation
set; a variant that changes how episodes are drawn, as `inflated_inscribed`, has its own. All are compared
with the first variant, which is the preset `cpu` as the sweep's file overrides it: without mirror images,
points ahead on the path and recovery, and with a curriculum. So they are not of the shipped agents.""",
)
_FURTHER = _SweepPage(
    part="further",
    sweep="examples/sweeps/hard_further.yaml",
    title="Short further training in the hard scenes",
    about="""A run of the preset `cpu`, which has not seen the hard scenes, goes on learning in them for
the steps that its variant names; `before` only evaluates it, so that it is the same with each seed. All
are evaluated with the actor alone, without exploration noise and recovery, on the same held-out episodes
of the hard scenes, which belong to no evaluation set.""",
    start="modpush train cpu --train.no-async-collection --out runs/train",
)


def ablation_table(trials: pd.DataFrame, curves: pd.DataFrame) -> pd.DataFrame:
    """A sweep's trials by variant, compared with its first variant.

    Args:
        trials: `trials.csv` of a sweep; only finished trials count.
        curves: `curves.csv` of the same sweep.

    Returns:
        By group and variant: `seeds`; `success`, `spl`, `contact_rate` and `collision_rate` of the last
        evaluation, mean over the seeds; `lowest` and `highest` success; `area`, the mean success of all
        evaluations; `steps_to_0.9`, the mean over the seeds of the steps after which the success rate
        first was 0.9 (NaN if it was not with every seed); and against the first variant with the same
        seeds `difference` in success, `p` and `effect_size` of the paired t-test (NaN with fewer than
        three seeds).

    Raises:
        ValueError: If no trial of the first variant has finished.
    """
    baseline = trials["variant"].iloc[0]
    finished = trials[trials["state"] == "finished"]
    reference = finished[finished["variant"] == baseline].set_index("seed")["final_success"]
    if reference.empty:
        raise ValueError(
            f"ablation_table: no trial of {baseline!r}, the first variant, is finished."
        )
    lines = []
    for (group, variant), own in finished.groupby(["group", "variant"], sort=False):
        seeds = own["seed"].tolist()
        chosen = curves[(curves["variant"] == variant) & curves["seed"].isin(seeds)]
        line = {"group": group, "variant": variant, "seeds": len(own)}
        line |= {"success": own["final_success"].mean()}
        line |= {"lowest": own["final_success"].min(), "highest": own["final_success"].max()}
        for metric in ("spl", "contact_rate", "collision_rate"):
            line[metric] = own[f"final_{metric}"].mean()
        line["area"] = chosen.groupby("seed")["success"].mean().mean()
        line[f"steps_to_{_REACHED:g}"] = _steps_to(chosen)
        others = None if variant == baseline else reference
        lines.append(line | _against(own.set_index("seed")["final_success"], others))
    return pd.DataFrame(lines).set_index(["group", "variant"])


def _steps_to(curves: pd.DataFrame) -> float:
    reached = curves[curves["success"] >= _REACHED].groupby("seed")["step"].min()
    return float(reached.mean()) if len(reached) == curves["seed"].nunique() else math.nan


def _against(own: pd.Series, reference: pd.Series | None) -> dict[str, float]:
    common = own.index.intersection([] if reference is None else reference.index)
    if reference is None or len(common) == 0:
        return {"difference": math.nan, "p": math.nan, "effect_size": math.nan}
    test = paired_t_test(own[common], reference[common])
    if test.count < _TESTED:
        return {"difference": test.difference, "p": math.nan, "effect_size": math.nan}
    return {"difference": test.difference, "p": test.p, "effect_size": test.effect_size}


def write_ablations(config: ReproduceConfig) -> None:
    """Write `ablations.md`, `.csv`, `.tex` and `.png` from a sweep's folder.

    Raises:
        FileNotFoundError: If there is no sweep in the folder, with the command that runs one.
        ValueError: If no trial of its first variant has finished.
    """
    _write_sweep(_ABLATIONS, config.sweep, config)


def write_further(config: ReproduceConfig) -> None:
    """Write `further.md`, `.csv`, `.tex` and `.png` from a sweep's folder.

    Raises:
        FileNotFoundError: If there is no sweep in the folder, with the command that runs one.
        ValueError: If no trial of its first variant has finished.
    """
    _write_sweep(_FURTHER, config.further, config)


def _write_sweep(page: _SweepPage, folder: Path, config: ReproduceConfig) -> None:
    paths = [folder / name for name in ("trials.csv", "curves.csv")]
    if not all(path.exists() for path in paths):
        raise FileNotFoundError(
            f"write_{page.part}: there is no sweep in {folder}; run modpush sweep {page.sweep} --out "
            f"{folder}."
        )
    trials, curves = (pd.read_csv(path) for path in paths)
    table = ablation_table(trials, curves)
    out = config.out / page.part
    write_text(out.with_suffix(".csv"), table.to_csv())
    write_text(out.with_suffix(".tex"), format_table(_as_text(table), "latex"))
    draw_sweep(curves, out.with_suffix(".png"), baseline=str(trials["variant"].iloc[0]))
    for path in paths:
        write_text(config.out / f"{page.part}_{path.name}", path.read_text(encoding="utf-8"))
    sweep = f"modpush sweep {page.sweep} --out runs/{folder.name}"
    command = "; ".join(filter(None, [page.start, sweep, config.command(page.part)]))
    finished = trials[trials["state"] == "finished"]
    seeds = ", ".join(str(seed) for seed in sorted(finished["seed"].unique()))
    steps = sorted(trials["total_steps"].unique())
    about = page.about.format(
        steps=" or ".join(f"{value:,}".replace(",", " ") for value in steps),
        minutes=finished["minutes"].mean() if "minutes" in finished else math.nan,
    )
    text = _TEXT.format(
        title=page.title,
        sources=sources_text(command, read_sessions(folder), seeds, _time_text(finished)),
        about=about,
        baseline=trials["variant"].iloc[0],
        table=format_table(_as_text(table)),
        missing=_missing_text(trials),
        part=page.part,
    )
    write_text(out.with_suffix(".md"), text)


def _time_text(finished: pd.DataFrame) -> str:
    """How long training took. Killed sessions have left no record, but each run knows its own time."""
    if "minutes" not in finished:
        return f"not known, {len(finished)} training runs"
    hours = finished["minutes"].sum() / 60
    return (
        f"{hours:.1f} hours for {len(finished)} training runs, added up over those at the same time"
    )


def _missing_text(trials: pd.DataFrame) -> str:
    """How much of a sweep has been run, and of which variants nothing."""
    finished = trials[trials["state"] == "finished"]
    if len(finished) == len(trials):
        return "All runs are finished."
    failed = trials[trials["state"] == "failed"]
    names = ", ".join(
        f"`{n}`" for n in dict.fromkeys(trials["variant"]) if n not in set(finished["variant"])
    )
    return (
        f"Of {len(trials)} runs {len(finished)} are finished"
        + (f", {len(failed)} failed" if len(failed) else "")
        + (f"; there is none yet of {names}." if names else ".")
    )


def _as_text(table: pd.DataFrame) -> pd.DataFrame:
    shown = pd.DataFrame(index=table.index)
    shown["seeds"] = table["seeds"].astype(str)
    shown["success"] = [
        f"{row.success:.3f} ({row.lowest:.3f} to {row.highest:.3f})" for row in table.itertuples()
    ]
    for name in ("spl", "contact_rate", "collision_rate", "area"):
        shown[name] = table[name]
    steps = table[f"steps_to_{_REACHED:g}"]
    shown[f"steps to {_REACHED:g}"] = ["–" if np.isnan(s) else f"{s:.0f}" for s in steps]
    shown["difference"] = ["–" if np.isnan(d) else f"{d:+.3f}" for d in table["difference"]]
    shown["p"] = ["–" if np.isnan(p) else f"{p:.2g}" for p in table["p"]]
    shown["d"] = ["–" if np.isnan(d) else f"{d:+.2f}" for d in table["effect_size"]]
    return shown


_TEXT = """# {title}

{sources}
{about} Figures are of the last evaluation, means over the seeds, success with its lowest and highest
seed; `area` is the mean success of all evaluations. Differences are from `{baseline}` with the same
seeds; from three on with a paired t-test, which tells only large ones from chance. {missing}

{table}
![learning curves: the mean over the seeds and their range]({part}.png)
"""
