"""The paper's Tables II to IV: an agent and the controllers beside the printed figures, with tests."""

import functools
import itertools
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import pandas as pd

from modpush.evaluation.sets import BEHIND_SETS
from modpush.evaluation.tables import format_table
from paper.provenance import sources_text
from paper.published import printed_rows
from paper.rows import read_rows
from paper.statistics import (
    RETRAINED,
    RULES,
    judge,
    make_cells,
    make_tests,
    stands_for,
)

__all__ = ["CONTROLLERS", "TABLES", "Section", "table_text", "verdicts", "verdicts_text"]

CONTROLLERS = ("corridor", "corridor_faithful")
_TRAINED_FURTHER = "small_cube"  # the agent that the one of `RETRAINED` comes from


@dataclass(frozen=True, kw_only=True)
class Section:
    """A block of a table: one object in one evaluation set."""

    title: str
    evaluation_set: str
    note: str = ""

    @property
    def titles(self) -> dict[str, str]:
        """Titles by set: with the tool in any direction, and straight behind where there is a set."""
        behind = f"behind/{self.evaluation_set}"
        found = {self.evaluation_set: self.title}
        return found | (
            {behind: f"{self.title}, tool straight behind"} if behind in BEHIND_SETS else {}
        )


TABLES = {
    "free": (Section(title="Small cube", evaluation_set="free/small_cube"),),
    "obstacles": (
        Section(title="Small cube", evaluation_set="obstacles/small_cube"),
        Section(title="Large cube", evaluation_set="obstacles/large_cube"),
        Section(title="Small cylinder", evaluation_set="obstacles/small_cylinder"),
        Section(title="Fragment", evaluation_set="obstacles/fragment"),
    ),
    "hard": (
        Section(
            title="The authors' layouts, as many episodes as in the paper",
            evaluation_set="hard/small_cube",
        ),
        Section(
            title="The authors' layouts, 200 episodes",
            evaluation_set="hard200/small_cube",
            note="The first 50 of these episodes are those of `hard/small_cube` with this start.",
        ),
        Section(
            title="Wider gaps",
            evaluation_set="hard_wide/small_cube",
            note="Easier than the paper's scenes: the short bars are 6 to 8 cm long, not 10. The paper "
            "has no figures for them.",
        ),
    ),
}
"""Sections of the paper's Tables II, III and IV. Source: paper Sec. V."""
_HEADS = {
    "success": "success",
    "contact_rate": "contact",
    "contact_rate_at_end": "contact, one look a step",
    "collision_rate": "collision",
    "collision_rate_at_end": "collision, one look a step",
    "collision_rate_object_at_end": "collision of the object, one look a step",
    "spl": "SPL, exact",
    "spl_authors_agent": "SPL, the authors' agent's yardstick",
    "spl_authors_controller": "SPL, their controller's yardstick",
    "path_length": "path (m)",
    "mean_jerk": "jerk (m/s³)",
    "reversal_rate": "reversals",
}
_PART_OF = {f"{start}hard/small_cube": f"{start}hard200/small_cube" for start in ("", "behind/")}
"""Sets whose episodes are the first of another one, by which they are not counted again."""


def table_text(name: str, agent: str) -> str:
    """One of the paper's tables in Markdown: for each set the figures, and tests of the agent.

    Args:
        name: A name in `TABLES`.
        agent: Name of the agent in the rows.
    """
    texts: list[str] = []
    frames: list[pd.DataFrame] = []
    for section, evaluation_set, title in _measured(name, agent):
        rows, cells, tests = _figures(agent, evaluation_set)
        frames += rows.values()
        display = _display(cells, evaluation_set)
        texts += [f"### {title}", section.note, format_table(display).strip()]
        texts += _test_texts(agent, tests)
    origins = (f[["commit", "machine"]].drop_duplicates().to_dict("records") for f in frames)
    sets = ", ".join(f"`{key}`" for _, key, _ in _measured(name, agent))
    sources = sources_text(
        "python -m paper run; python -m paper rows; python -m paper tables",
        f"the sets {sets}",
        itertools.chain.from_iterable(origins),
    )
    return "\n\n".join([sources.strip(), *filter(None, texts)]) + "\n"


def _measured(name: str, agent: str) -> list[tuple[Section, str, str]]:
    """The sections of a table, with each of their sets that an agent has rows of, and its title.

    Raises:
        KeyError: If it has rows of none.
    """
    found = [
        (section, evaluation_set, title)
        for section in TABLES[name]
        for evaluation_set, title in section.titles.items()
        if (agent, evaluation_set) in read_rows()
    ]
    if not found:
        raise KeyError(f"There are no rows of {agent!r} on a set of {name!r}.")
    return found


@functools.cache
def _figures(
    agent: str, evaluation_set: str
) -> tuple[dict[str, pd.DataFrame], pd.DataFrame, pd.DataFrame]:
    """Rows by method as far as there are some, the agent's first, with their cells and tests."""
    rows = read_rows()
    with_object = agent == _TRAINED_FURTHER and evaluation_set.endswith(f"/{RETRAINED}")
    others = ([RETRAINED] if with_object else []) + [*CONTROLLERS]
    methods = [agent, *(method for method in others if (method, evaluation_set) in rows)]
    found = {method: rows.of(method, evaluation_set) for method in methods}
    return found, make_cells(found), make_tests(found)


def _display(cells: pd.DataFrame, evaluation_set: str) -> pd.DataFrame:
    """A section as text: our methods, then the paper's rows."""
    metrics = list(dict.fromkeys(cells["metric"]))
    lines = []
    for method, own in cells.groupby("method", sort=False):
        by_metric = own.set_index("metric")
        line = {"method": str(method), "episodes": str(int(by_metric.loc["success", "count"]))}
        lines.append(line | {_HEADS[m]: _cell(m, by_metric.loc[m]) for m in metrics})
    for row in printed_rows(evaluation_set):
        line = dict.fromkeys(lines[0], "–") | {"method": row.name, "episodes": str(row.episodes)}
        figures = {
            _HEADS[stands_for(m, row.name, metrics, evaluation_set)]: (
                f"{v:g} ± {row.stds[m]:g}" if m in row.stds else f"{v:g}"
            )
            for m, v in row.figures.items()
        }
        lines.append(line | figures)
    return pd.DataFrame(lines).set_index("method")


def _cell(metric: str, cell: pd.Series) -> str:
    if np.isnan(cell["mean"]):
        return "–"
    if metric == "success" or metric.startswith("spl"):
        return f"{cell['mean']:.3f} [{cell['low']:.3f}, {cell['high']:.3f}]"
    return f"{cell['mean']:.3f} ± {cell['std']:.3f}".replace("nan", "–")


def _test_texts(agent: str, tests: pd.DataFrame) -> Iterator[str]:
    if tests.empty:
        return
    forms = {"difference": "{:+.3f}", "t": "{:.2f}", "p": "{:.2g}", "effect_size": "{:+.2f}"}
    shown = tests.assign(
        **{name: tests[name].map(form.format).replace("nan", "–") for name, form in forms.items()}
    ).rename(columns={"count": "pairs", "effect_size": "d"})
    columns = ["metric", "pairs", "difference", "t", "p", "d", "verdict"]
    for second, frame in shown.groupby("second", sort=False):
        yield f"`{agent}` minus `{second}`, paired t-tests:"
        yield format_table(frame[columns].set_index("metric")).strip()


def verdicts(agent: str) -> pd.DataFrame:
    """All verdicts on an agent: beside the paper's rows, and beside the methods measured here.

    Returns:
        Columns of `judge`, and `table`, `title` and `set`.
    """
    frames = []
    for table in TABLES:
        for _, evaluation_set, title in _measured(table, agent):
            _, cells, tests = _figures(agent, evaluation_set)
            about = {"table": table, "title": title, "set": evaluation_set}
            for frame in (judge(cells, evaluation_set), _judged(tests)):
                if len(frame):
                    frames.append(frame.assign(**about))
    found = pd.concat(frames, ignore_index=True)
    return found[~found["method"].isin(CONTROLLERS)]


def _judged(tests: pd.DataFrame) -> pd.DataFrame:
    """The tests' verdicts in the columns of `judge`; there is none with fewer than two pairs."""
    if tests.empty:
        return tests
    tests = tests[tests["count"] > 1]
    versus = tests["second"] + ", measured here"
    names = {"first": "method", "first_mean": "mean", "second_mean": "theirs"}
    kept = tests.rename(columns=names).assign(versus=versus, ours=tests["metric"])
    return kept[["method", "versus", "metric", "ours", "mean", "theirs", "verdict"]]


def verdicts_text(agent: str) -> str:
    """Verdicts in Markdown: the rules, counts for each start of the tool, and lists beside the paper.

    The counts leave out a set whose episodes are part of another one that is there.
    """
    found = verdicts(agent)
    parts = [RULES.strip()]
    behind = found["set"].str.startswith("behind/")
    starts = {"in any direction from": found[~behind], "straight behind": found[behind]}
    for start, chosen in starts.items():
        sets = set(chosen["set"])
        repeated = [part for part, whole in _PART_OF.items() if {part, whole} <= sets]
        counted = chosen[~chosen["set"].isin(repeated)]
        if len(counted):
            counts = counted.groupby(["method", "versus"], sort=False)["verdict"].value_counts()
            table = counts.unstack(fill_value=0)
            table = table.reindex(columns=["ahead", "level", "behind"], fill_value=0)
            note = "".join(
                f", without `{part}`, which is part of `{_PART_OF[part]}`" for part in repeated
            )
            parts.append(f"The tool starts {start} the object{note}:")
            parts.append(format_table(table).strip())
    printed = found[found["versus"].str.startswith("paper:")]
    for verdict in ("ahead", "level", "behind"):
        lines = [
            f"- {table}, {title}, {method} against {versus}: "
            + ", ".join(f"{r.ours} {r.mean:.3f} ({r.theirs:.3f})" for r in own.itertuples())
            for (table, title, method, versus), own in printed[
                printed["verdict"] == verdict
            ].groupby(["table", "title", "method", "versus"], sort=False)
        ]
        parts += [f"### {verdict.capitalize()}", "\n".join(lines) or "Nothing."]
    return "\n\n".join(parts) + "\n"
