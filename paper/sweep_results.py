"""Results of a sweep: its evaluations as tables, a comparison with its first variant, and a figure."""

import math
from collections.abc import Sequence
from pathlib import Path

import matplotlib
import pandas as pd

from modpush.evaluation.tables import format_table, paired_t_test
from paper.provenance import origin_of, sources_text
from paper.sweep import Trial, evaluations_of, is_finished

matplotlib.use("Agg")  # no screen is needed
import matplotlib.pyplot as plt
from matplotlib.axes import Axes

__all__ = ["collect_trials", "draw_sweep", "sweep_table", "sweep_text"]

METRICS = ("success", "spl", "contact_rate", "collision_rate")
"""Metrics of the greedy evaluations on held-out episodes that are collected."""
_REACHED = 0.9  # success rate whose first step is given
_TESTED = 3  # seeds from which on there is a test: two that happen to differ alike would give p = 0


def collect_trials(trials: Sequence[Trial], folder: Path) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Write `trials.csv` and `curves.csv` to a sweep's folder, and return them.

    Returns:
        A row for each trial that has been evaluated: `variant`, `group`, `seed`, `finished` and its last
        evaluation; and a row for each evaluation.
    """
    last, curves = [], []
    for trial in trials:
        if (table := evaluations_of(trial, folder)) is None:
            continue
        about = {"variant": trial.variant, "group": trial.group, "seed": trial.seed}
        curves.append(table[["step", "minutes", *METRICS]].assign(**about))
        last.append(curves[-1].tail(1).assign(finished=is_finished(trial, folder)))
    if not last:
        raise ValueError(f"collect_trials: no run in {folder} has been evaluated yet.")
    tables = pd.concat(last, ignore_index=True), pd.concat(curves, ignore_index=True)
    for name, table in zip(("trials", "curves"), tables, strict=True):
        table.to_csv(folder / f"{name}.csv", index=False)
    return tables


def sweep_table(trials: pd.DataFrame, curves: pd.DataFrame) -> pd.DataFrame:
    """The finished trials by variant, compared with the first variant.

    Args:
        trials: The first result of `collect_trials`.
        curves: The second one.

    Returns:
        By group and variant: `seeds`; means over the seeds of the last evaluations' metrics; `lowest` and
        `highest` success; `area`, the mean success of all evaluations; `steps_to_0.9`, the mean over the
        seeds of the first step with a success rate of 0.9 (NaN if one has none); and against the first
        variant with the same seeds `difference` in success, `p` and `effect_size` of the paired t-test
        (NaN with fewer than three seeds).

    Raises:
        ValueError: If no trial of the first variant is finished.
    """
    baseline = trials["variant"].iloc[0]
    finished = trials[trials["finished"]]
    reference = finished[finished["variant"] == baseline].set_index("seed")["success"]
    if reference.empty:
        raise ValueError(f"sweep_table: no trial of {baseline!r}, the first variant, is finished.")
    lines = []
    for (group, variant), own in finished.groupby(["group", "variant"], sort=False):
        success = own.set_index("seed")["success"]
        chosen = curves[(curves["variant"] == variant) & curves["seed"].isin(success.index)]
        reached = chosen[chosen["success"] >= _REACHED].groupby("seed")["step"].min()
        common = success.index.intersection(reference.index if variant != baseline else [])
        test = paired_t_test(success[common], reference[common])
        tested = test.count >= _TESTED
        lines.append(
            {"group": group, "variant": variant, "seeds": len(own)}
            | {name: own[name].mean() for name in METRICS}
            | {"lowest": success.min(), "highest": success.max()}
            | {"area": chosen.groupby("seed")["success"].mean().mean()}
            | {f"steps_to_{_REACHED:g}": reached.mean() if len(reached) == len(own) else math.nan}
            | {"difference": test.difference}
            | {"p": test.p if tested else math.nan}
            | {"effect_size": test.effect_size if tested else math.nan}
        )
    return pd.DataFrame(lines).set_index(["group", "variant"])


def sweep_text(trials: pd.DataFrame, curves: pd.DataFrame, command: str, folder: Path) -> str:
    """The table of a sweep in Markdown, with its command and origin."""
    table = sweep_table(trials, curves)
    forms = {"area": "{:.3f}", f"steps_to_{_REACHED:g}": "{:.0f}", "difference": "{:+.3f}"}
    forms |= {"p": "{:.2g}", "effect_size": "{:+.2f}"}
    shown = table.drop(columns=["lowest", "highest"])
    shown["success"] = [
        f"{row.success:.3f} ({row.lowest:.3f} to {row.highest:.3f})" for row in table.itertuples()
    ]
    for name, form in forms.items():
        shown[name] = table[name].map(form.format).replace({"nan": "–", "+nan": "–"})
    finished = trials[trials["finished"]]
    seeds = ", ".join(map(str, sorted(finished["seed"].unique())))
    sources = sources_text(command, seeds, [origin_of(folder)])
    hours = finished["minutes"].sum() / 60
    note = f"{len(finished)} of {len(trials)} runs are finished, in {hours:.1f} hours of training."
    return f"{sources}\n{note}\n\n{format_table(shown)}"


def draw_sweep(curves: pd.DataFrame, path: Path, columns: int = 3) -> None:
    """Draw success against the environment steps, a panel for each group beside the first variant.

    Lines are means over the seeds, shaded the range between the lowest and the highest of them.

    Args:
        curves: The second result of `collect_trials`.
        path: The picture's file.
        columns: Number of panels in a row.
    """
    baseline = curves["variant"].iloc[0]
    groups = list(dict.fromkeys(curves.loc[curves["variant"] != baseline, "group"])) or [""]
    rows, columns = math.ceil(len(groups) / columns), min(columns, len(groups))
    figure, axes = plt.subplots(
        rows,
        columns,
        figsize=(6.2 * columns, 3.3 * rows),
        squeeze=False,
        sharey=True,
        layout="constrained",
    )
    for axis in axes.flat[len(groups) :]:
        axis.axis("off")
    for axis, group in zip(axes.flat, groups, strict=False):
        _draw_variant(axis, curves[curves["variant"] == baseline], baseline, "black")
        chosen = curves[(curves["group"] == group) & (curves["variant"] != baseline)]
        for number, (variant, table) in enumerate(chosen.groupby("variant", sort=False)):
            _draw_variant(axis, table, str(variant), f"C{number}")
        axis.set(title=group, xlabel="environment steps", ylabel="success", ylim=(0.0, 1.02))
        axis.grid(alpha=0.3)
        # Beside the panel, since a group of many variants would cover its own curves.
        axis.legend(fontsize="small", loc="upper left", bbox_to_anchor=(1.0, 1.0))
    figure.savefig(path, dpi=80, pil_kwargs={"optimize": True})
    plt.close(figure)


def _draw_variant(axis: Axes, table: pd.DataFrame, label: str, colour: str) -> None:
    # As far as all seeds have come.
    seeds = table.pivot_table(index="step", columns="seed", values="success").dropna()
    axis.plot(seeds.index, seeds.mean(axis=1), color=colour, marker=".", label=label)
    axis.fill_between(seeds.index, seeds.min(axis=1), seeds.max(axis=1), color=colour, alpha=0.15)
