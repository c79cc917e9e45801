"""The paper's three tables of results: which sets they are of, and their pages."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pandas as pd
from tqdm import tqdm

from modpush._provenance import Session, sources_text
from modpush.evaluation.sets import BEHIND_SETS, load_set
from modpush.evaluation.tables import format_table
from modpush.files import write_text
from modpush.reproduction.cells import make_cells, make_tests
from modpush.reproduction.config import ReproduceConfig
from modpush.reproduction.measure import RETRAINED, Measured, measure, methods_for
from modpush.reproduction.printed import judge, printed_rows, stands_for

__all__ = ["PAPER_TABLES", "Section", "Table", "write_paper_table"]


@dataclass(frozen=True, kw_only=True)
class Section:
    """A block of a table: one object in one evaluation set."""

    title: str
    evaluation_set: str
    pushed_object: str
    printed: str | None
    """The paper's set whose figures stand beside ours; None where it has none."""
    note: str = ""


@dataclass(frozen=True, kw_only=True)
class Table:
    """A table of the paper."""

    title: str
    sections: tuple[Section, ...]


def _both_starts(*sections: Section) -> tuple[Section, ...]:
    """Each section, followed by the same with the tool straight behind, where there is a set."""
    behind = [
        replace(
            s, title=f"{s.title}, tool straight behind", evaluation_set=f"behind/{s.evaluation_set}"
        )
        for s in sections
    ]
    pairs = zip(sections, behind, strict=True)
    return tuple(
        s for pair in pairs for s in pair if s in sections or s.evaluation_set in BEHIND_SETS
    )


def _obstacles(title: str, name: str) -> Section:
    key = f"obstacles/{name}"
    return Section(title=title, evaluation_set=key, pushed_object=name, printed=key)


PAPER_TABLES = {
    "free": Table(
        title="Table II: straight pushes in free space",
        sections=_both_starts(
            Section(
                title="Small cube",
                evaluation_set="free/small_cube",
                pushed_object="small_cube",
                printed="free/small_cube",
            ),
        ),
    ),
    "obstacles": Table(
        title="Table III: scenes with obstacles, one agent for the four objects",
        sections=_both_starts(
            _obstacles("Small cube", "small_cube"),
            _obstacles("Large cube", "large_cube"),
            _obstacles("Small cylinder", "small_cylinder"),
            _obstacles("Fragment", "fragment"),
        ),
    ),
    "hard": Table(
        title="Table IV: unseen scenes, dense with clutter",
        sections=_both_starts(
            Section(
                title="The authors' layouts, as many episodes as in the paper",
                evaluation_set="hard/small_cube",
                pushed_object="small_cube",
                printed="hard/small_cube",
            ),
            Section(
                title="The authors' layouts, 200 episodes",
                evaluation_set="hard200/small_cube",
                pushed_object="small_cube",
                printed="hard/small_cube",
                note="The first 50 of these episodes are those of `hard/small_cube` with this start.",
            ),
            Section(
                title="Wider gaps",
                evaluation_set="hard_wide/small_cube",
                pushed_object="small_cube",
                printed=None,
                note="Easier than the paper's scenes: the short bars are 6 to 8 cm long, not 10. The "
                "paper has no figures for them.",
            ),
        ),
    ),
}
"""The paper's tables by name. Source: paper Sec. V."""

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
_LEGEND = """
Success and SPL are over all episodes, with 95 % intervals (Wilson's for success, bootstrapped for
SPL). As in the paper, the other columns are over the episodes that both methods of a pair solved,
with their standard deviation; their intervals are in the CSV file. A controller's pair is the
agent, the agent's is `corridor`. `corridor` is Krivic and Piater's controller as built here,
`corridor_faithful` the same by the rules of the authors' code.

In the sections "tool straight behind" the tool starts 9 cm straight behind the object as seen from the
goal, as in the code of the paper's authors; in the others in any direction from the object, since the
paper's text says "sampled around the object". Contact and SPL depend on the start, so that the printed
figures stand beside both.

SPL has three yardsticks: the exact shortest path inside the workspace, the Lazy Theta* by which the
paper's authors measured their agent, and the staircase of cells by which they measured their
controller among obstacles. Contact counts a step in which any of four looks shows it; "one look a
step" counts the look at its end alone, as the authors' code. Collisions are those of object, tool or
arm; with one look a step they are what the authors count for their controller, and of the object
alone what they count for their agent. Jerk is the mean of the tip's third derivative, and reversals
are the share of its moves that are turned by more than 90 degrees from the one before. A printed
figure stands in the column that is measured as the authors measured it, with the standard deviation
that the paper prints.
"""
_RETRAINED_LEGEND = """
`agent_retrained` is the agent that `--policy-files` names for an object, which it was trained with. It is
judged against the paper's agent that was trained further with this object, and `agent` against the
paper's that was not.
"""


def write_paper_table(name: str, config: ReproduceConfig) -> None:
    """Measure a table's episodes, and write it as Markdown, LaTeX and CSV, with tests and verdicts.

    Writes `<name>.md`, `<name>.tex`, `<name>_cells.csv`, `<name>_tests.csv`, `<name>_verdicts.csv` and
    the rows of each method and set as `rows/<method>_<set>.csv.gz`.

    Args:
        name: A name in `PAPER_TABLES`.
        config: Agents, number of episodes and folders.
    """
    table = PAPER_TABLES[name]
    blocks, cells, tests, verdicts = [], [], [], []
    latex: list[str] = []
    sessions: list[Session] = []
    seeds = []
    for section in tqdm(table.sections, desc=name, unit="set", disable=not config.progress):
        measured = _measure(section, config)
        rows = {method: item.rows for method, item in measured.items()}
        sessions += [s for item in measured.values() for s in item.sessions]
        for method, item in measured.items():
            _keep_rows(item.rows, config.out, method, section.evaluation_set)
        own_cells, own_tests = make_cells(rows), make_tests(rows)
        display = _display(own_cells, section)
        blocks.append(_section_text(section, display, own_tests, len(rows["agent"])))
        latex.append(f"% {section.title}\n{format_table(display, 'latex')}")
        label = {"table": name, "section": section.title, "set": section.evaluation_set}
        whole = len(load_set(section.evaluation_set))
        cells.append(own_cells.assign(**label))
        tests.append(own_tests.assign(**label))
        label |= {"episodes": len(rows["agent"]), "episodes_of_set": whole}
        verdicts += [judge(own_cells, section.printed).assign(**label)]
        verdicts += [_test_verdicts(own_tests).assign(**label)]
        seeds.append(f"`{section.evaluation_set}`")
    sources = sources_text(config.command(name), sessions, f"the sets {', '.join(seeds)}")
    retrained = any(RETRAINED in frame["method"].to_numpy() for frame in cells)
    legend = _LEGEND + (_RETRAINED_LEGEND if retrained else "")
    text = "\n".join([f"# {table.title}\n", sources, *blocks, "## How to read it", legend])
    write_text(config.out / f"{name}.md", text)
    write_text(config.out / f"{name}.tex", "\n".join(latex))
    for ending, frames in (("cells", cells), ("tests", tests), ("verdicts", verdicts)):
        joined = pd.concat([frame for frame in frames if len(frame)], ignore_index=True)
        write_text(config.out / f"{name}_{ending}.csv", joined.to_csv(index=False))


def _measure(section: Section, config: ReproduceConfig) -> dict[str, Measured]:
    episodes = load_set(section.evaluation_set)
    methods = methods_for(config, section.pushed_object)
    return {name: measure(method, episodes, config) for name, method in methods.items()}


def _keep_rows(rows: pd.DataFrame, out: Path, method: str, evaluation_set: str) -> None:
    path = out / "rows" / f"{method}_{evaluation_set.replace('/', '_')}.csv.gz"
    path.parent.mkdir(parents=True, exist_ok=True)
    # Without the time in gzip's header the same rows are the same file.
    rows.to_csv(path, index=False, compression={"method": "gzip", "mtime": 0})


def _display(cells: pd.DataFrame, section: Section) -> pd.DataFrame:
    """A section as text: ours, then the paper's rows."""
    metrics = list(dict.fromkeys(cells["metric"]))
    lines = []
    for method, own in cells.groupby("method", sort=False):
        by_metric = own.set_index("metric")
        line = {"method": str(method), "episodes": str(int(by_metric.loc["success", "count"]))}
        lines.append(line | {_HEADS[m]: _cell(m, by_metric.loc[m]) for m in metrics})
    for row in printed_rows(section.printed):
        line = dict.fromkeys(lines[0], "–") | {"method": row.name, "episodes": str(row.episodes)}
        figures = {
            _HEADS[stands_for(m, row.name, metrics, section.printed)]: (
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
    std = "–" if np.isnan(cell["std"]) else f"{cell['std']:.3f}"
    return f"{cell['mean']:.3f} ± {std}"


def _section_text(section: Section, display: pd.DataFrame, tests: pd.DataFrame, count: int) -> str:
    forms = {"difference": "{:+.3f}", "t": "{:.2f}", "p": "{:.2g}", "effect_size": "{:+.2f}"}
    shown = tests.assign(
        **{
            name: ["–" if np.isnan(value) else form.format(value) for value in tests[name]]
            for name, form in forms.items()
        }
    ).rename(columns={"count": "pairs", "effect_size": "d"})
    columns = ["metric", "pairs", "difference", "t", "p", "d", "verdict"]
    whole = len(load_set(section.evaluation_set))
    part = f"The first {count} of {whole} episodes. " if count < whole else ""
    lines = [f"## {section.title}", f"{part}{section.note}".strip(), format_table(display)]
    for second, frame in shown.groupby("second", sort=False):
        lines += [
            f"Agent minus `{second}`, paired t-tests:",
            format_table(frame[columns].set_index("metric")),
        ]
    return "\n\n".join(line.strip() for line in lines if line.strip()) + "\n"


def _test_verdicts(tests: pd.DataFrame) -> pd.DataFrame:
    """The tests' verdicts in the columns of `judge`; there is none with fewer than two pairs."""
    tests = tests[tests["count"] > 1]
    return pd.DataFrame(
        {
            "method": tests["first"],
            "versus": [f"{name}, measured here" for name in tests["second"]],
            "metric": tests["metric"],
            "ours": tests["metric"],
            "mean": tests["first_mean"],
            "low": np.nan,
            "high": np.nan,
            "theirs": tests["second_mean"],
            "verdict": tests["verdict"],
        }
    )
