"""Tables between comments of the pages, written from the rows in `docs/results/rows.parquet`.

A table replaces what stands between `<!-- results: NAME -->` and `<!-- end -->`, in README.md or a page
of docs/. A table whose page has gone is an error, so that no name outlives its use.
"""

import re
from collections.abc import Callable, Iterator, Mapping
from functools import partial
from pathlib import Path

import pandas as pd

from modpush.evaluation.tables import format_table
from paper.published import AGENT, AGENT_RETRAINED, measured_as, paper_set, printed_rows
from paper.rows import ROOT, read_rows
from paper.statistics import mean_of
from paper.tables import CONTROLLERS, TABLES, table_text, verdicts, verdicts_text

__all__ = ["AGENTS", "BLOCKS", "replace_blocks", "write_blocks"]

AGENTS = ("any_object", "small_cube")
WITH_THE_PAPERS_VALUES = "paper"
"""The agent that observes the 49 values of the paper; it has tables of its own."""
SEEDS = (1, 2)
"""Further seeds of the agents, whose rows are those of `<agent>_seed_<seed>`."""
SETS = {
    "free/small_cube": "free, small cube",
    "obstacles/small_cube": "clutter, small cube",
    "obstacles/large_cube": "clutter, large cube",
    "obstacles/small_cylinder": "clutter, small cylinder",
    "obstacles/fragment": "clutter, fragment",
    "hard/small_cube": "hard, small cube",
    "hard200/small_cube": "hard, 200 episodes",
}
STARTS = {"": "any", "behind/": "behind"}
"""Start of the tool by the first part of a set's name."""
COLUMNS = {
    "success": "success",
    "contact_rate": "contact",
    "collision_rate": "collision of the object",
    "spl": "SPL",
}
"""The paper's metrics, and their names in the tables."""
STRICTER = {
    "contact_rate": "contact, four looks",
    "collision_rate": "collision, four looks",
    "collision_rate_at_end": "object or arm at the end",
    "spl": "SPL, exact",
    "mean_jerk": "jerk (m/s³)",
    "reversal_rate": "reversals",
}
"""Our metrics that the paper does not have, and their names in the tables."""
FAMILY = {
    "success": "success",
    "spl": "SPL, exact",
    "spl_authors_agent": "SPL, authors'",
    "contact_rate": "contact",
    "contact_rate_at_end": "contact at the end",
    "collision_rate": "collision",
    "collision_rate_object": "of the object",
    "collision_rate_arm": "of the arm",
    "path_length": "path (m)",
    "steps": "steps",
}
BLOCK = re.compile(r"<!-- results: ([\w ]+) -->\n.*?<!-- end -->", re.DOTALL)


def number(value: float) -> str:
    """Three decimals, and as many leading digits as it takes."""
    return "–" if pd.isna(value) else f"{value:.3f}" if abs(value) < 10 else f"{value:.0f}"


def success_table() -> str:
    """Success of `any_object`, with the tool at any angle, beside the paper's agent and controller."""
    lines: list[tuple[str, ...]] = [("set", "`any_object`", "paper's agent", "paper's controller")]
    for name, label in SETS.items():
        if not name.startswith("hard/"):
            ours = _mean("any_object", name, "success")
            printed = (row.figures["success"] for row in printed_rows(name)[:2])
            cells = [number(value) for value in (ours, *printed)]
            if "hard200" in name:
                cells[1:] = [f"{cell} (50 episodes)" for cell in cells[1:]]
            lines.append((label, *cells))
    return _markdown(lines)


def beside_paper_table() -> str:
    """Both agents beside the paper's, each metric as the authors measured it, for both starts."""
    lines = [("set", "tool's start", "episodes", *COLUMNS.values())]
    for name, label in SETS.items():
        for prefix, start in STARTS.items():
            count = min(len(read_rows().of(agent, f"{prefix}{name}")) for agent in AGENTS)
            cells = [_beside(metric, f"{prefix}{name}") for metric in COLUMNS]
            lines.append((label, start, str(count), *cells))
    return _markdown(lines)


def _beside(metric: str, name: str) -> str:
    """Ours, with the difference to the printed figure, and the printed figure."""
    figures = {row.name: row.figures.get(metric) for row in printed_rows(name)}
    theirs = figures[AGENT]
    column = measured_as(name, of_controller=False)[metric]
    cells = []
    for agent in AGENTS:
        mean = _mean(agent, name, column)
        difference = "" if theirs is None else f" ({_signed(round(mean, 3) - theirs)})"
        cells.append(number(mean) + difference)
    if theirs is None:
        printed = "–"
    else:
        printed = number(theirs) + (" (50 episodes)" if "hard200" in name else "")
    retrained = figures.get(AGENT_RETRAINED)
    return " / ".join([*cells, printed]) + (f", retrained {retrained:.3f}" if retrained else "")


def _signed(value: float) -> str:
    return "±0" if abs(value) < 5e-4 else f"{value:+.3f}".replace("-", "−")


def stricter_table() -> str:
    """Our own, stricter figures and the smoothness of motion of the agents."""
    lines = [("set", "tool's start", *STRICTER.values())]
    for name, label in SETS.items():
        for prefix, start in STARTS.items():
            cells = [
                " / ".join(number(_mean(agent, f"{prefix}{name}", metric)) for agent in AGENTS)
                for metric in STRICTER
            ]
            lines.append((label, start, *cells))
    return _markdown(lines)


def controller_table() -> str:
    """The corridor controller, and the success and SPL of the one by the authors' rules."""
    metrics = {
        "success": "success",
        "contact_rate": "contact",
        "contact_rate_at_end": "at the end",
        "collision_rate": "collision",
        "spl": "SPL, exact",
        "spl_authors_controller": "SPL, authors'",
        "path_length": "path (m)",
    }
    heads = (*metrics.values(), "by the authors' rules: success", "SPL, authors'")
    lines = [("set", "episodes", *heads)]
    for name, rows in _sets_of("corridor"):
        cells = [mean_of(rows, metric) for metric in metrics]
        by_rules = ("success", "spl_authors_controller")
        cells += [_mean("corridor_faithful", name, metric) for metric in by_rules]
        lines.append((f"`{name}`", str(len(rows)), *map(number, cells)))
    return _markdown(lines)


def family_tables(method: str) -> str:
    """A method's means by set and scene family, as `mean_of` takes them."""
    lines = [("set", "family", "episodes", *FAMILY.values())]
    for name, rows in _sets_of(method):
        families = dict(list(rows.groupby("scene", sort=False)))
        groups = {"all": rows} | (families if len(families) > 1 else {})
        for family, own in groups.items():
            cells = [number(mean_of(own, metric)) for metric in FAMILY]
            lines.append((f"`{name}`" if family == "all" else "", family, str(len(own)), *cells))
    return _markdown(lines)


def seeds_table(agent: str) -> str:
    """Mean and worst of an agent's three seeds on each set."""
    metrics = {key: FAMILY[key] for key in list(FAMILY)[:6]}
    names = (agent, *(f"{agent}_seed_{seed}" for seed in SEEDS))
    lines = [("set", "episodes", *metrics.values())]
    for name in (*SETS, "hard_wide/small_cube"):
        rows = [read_rows().of(method, name) for method in names]
        if len({len(own) for own in rows}) > 1:
            raise KeyError(
                f"The seeds of {agent!r} have run different numbers of episodes of {name!r}."
            )
        cells = []
        for metric in metrics:
            means = [mean_of(own, metric) for own in rows]
            worst = max(means) if metric == "collision_rate" else min(means)
            cells.append(f"{sum(means) / len(means):.3f}, {worst:.3f}")
        lines.append((f"`{name}`", str(len(rows[0])), *cells))
    return _markdown(lines)


def verdict_table(agent: str) -> str:
    """Metrics in which an agent is ahead of, level with and behind the paper's agents."""
    judged = verdicts(agent)
    judged = judged[judged["versus"].str.startswith("paper: agent")]
    lines: list[tuple[str, ...]] = [("set", "tool's start", "against", "ahead", "level", "behind")]
    for (name, method, versus), own in judged.groupby(["set", "method", "versus"], sort=False):
        words = [
            ", ".join(COLUMNS[m] for m in own.loc[own["verdict"] == verdict, "metric"])
            for verdict in ("ahead", "level", "behind")
        ]
        against = versus.removeprefix("paper: ").replace("agent", "the paper's agent")
        against = against if method == agent else f"ours retrained, {against}"
        start = "behind" if name.startswith("behind/") else "any"
        lines.append((SETS[paper_set(name)], start, against, *words))
    return _markdown(lines)


def _sets_of(method: str) -> Iterator[tuple[str, pd.DataFrame]]:
    """The sets that there are rows of a method of, with these."""
    for prefix in STARTS:
        for name in (*SETS, "hard_wide/small_cube"):
            if (method, f"{prefix}{name}") in read_rows():
                yield f"{prefix}{name}", read_rows().of(method, f"{prefix}{name}")


def _mean(method: str, name: str, metric: str) -> float:
    return mean_of(read_rows().of(method, name), metric)


def _markdown(lines: list[tuple[str, ...]]) -> str:
    head, *body = lines
    return format_table(pd.DataFrame(body, columns=list(head)).set_index(head[0]))


BLOCKS: dict[str, Callable[[], str]] = {
    "success": success_table,
    "agents": beside_paper_table,
    "stricter": stricter_table,
    "controllers": controller_table,
    **{
        f"families {name}": partial(family_tables, name)
        for name in (*AGENTS, WITH_THE_PAPERS_VALUES, *CONTROLLERS)
    },
    **{f"seeds {agent}": partial(seeds_table, agent) for agent in AGENTS},
    **{
        f"verdicts {agent}": partial(verdict_table, agent)
        for agent in (*AGENTS, WITH_THE_PAPERS_VALUES)
    },
    **{f"lists {agent}": partial(verdicts_text, agent) for agent in AGENTS},
    **{
        f"table {table} {agent}": partial(table_text, table, agent)
        for table in TABLES
        for agent in AGENTS
    },
}
"""Tables that are made of the rows, by name."""


def replace_blocks(page: str, texts: Mapping[str, str]) -> str:
    """A page with some of its tables replaced.

    Args:
        page: The page.
        texts: New tables by name. Tables of other names stay as they are.
    """

    def block(found: re.Match[str]) -> str:
        if found[1] not in texts:
            return found[0]
        return f"<!-- results: {found[1]} -->\n\n{texts[found[1]].strip()}\n\n<!-- end -->"

    return BLOCK.sub(block, page)


def write_blocks(texts: Mapping[str, str], root: Path = ROOT) -> list[Path]:
    """Write tables into README.md and the pages of docs/ that have their names.

    Args:
        texts: Tables by name.
        root: Folder of the repository.

    Returns:
        The pages that have one of the tables.

    Raises:
        ValueError: If no page has one of them.
    """
    pages = [root / "README.md", *sorted((root / "docs").rglob("*.md"))]
    before = {page: page.read_text(encoding="utf-8") for page in pages if page.exists()}
    names = {page: set(BLOCK.findall(text)) & set(texts) for page, text in before.items()}
    if missing := sorted(set(texts) - set().union(*names.values())):
        raise ValueError(f"write_blocks: no page has `<!-- results: ... -->` of {missing}.")
    for page in names:
        page.write_text(replace_blocks(before[page], texts), encoding="utf-8")
    return [page for page, found in names.items() if found]
