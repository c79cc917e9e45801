"""Write the tables of the shipped agents and controllers into README.md and the pages, from their rows.

    python benchmarks/results_tables.py success agents stricter  # these, from docs/results
    python benchmarks/results_tables.py                          # all tables
    python benchmarks/results_tables.py --copy runs/evaluate     # all tables, after new results

The agents' rows, in `docs/results/starts`, are those of `modpush evaluate`; the
controllers' rows and the verdicts, in `docs/results/paper`, are those of `modpush reproduce`
(docs/howto/reproduce.md). A table replaces what stands between its two comments in a page. `--copy` first
copies the agents' rows and all methods' tables by family from folders of `modpush evaluate`.
"""

import argparse
import gzip
import re
from collections.abc import Collection
from pathlib import Path

import pandas as pd

from modpush.evaluation.published_results import PAPER, measured_as, paper_set
from modpush.evaluation.sets import BEHIND_SETS, EVALUATION_SETS
from modpush.reproduction.cells import OVER_ALL

ROOT = Path(__file__).resolve().parents[1]
PAPER_FOLDER = ROOT / "docs" / "results" / "paper"
AGENTS = {
    name: ROOT / "docs" / "results" / "starts" / name for name in ("any_object", "small_cube")
}
"""Rows of `modpush evaluate` by agent."""
VERDICTS = {"any_object": PAPER_FOLDER / "any_object", "small_cube": PAPER_FOLDER}
"""Results of `modpush reproduce` by agent."""
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
"""The paper's metrics, and what the tables call them."""
STRICTER = {
    "contact_rate": "contact, four looks",
    "collision_rate": "collision, four looks",
    "collision_rate_at_end": "object or arm at the end",
    "spl": "SPL, exact",
    "mean_jerk": "jerk (m/s³)",
    "reversal_rate": "reversals",
}
"""Our metrics that the paper does not have, and what the tables call them."""
ABOUT = """
Contact is the share of an episode's steps, from the first contact on, at whose end the tool touches the
object. Collision is the share of steps at whose end the object touches an obstacle. Both are counted as
the paper's authors count them for their agent, and are means over the episodes that the agent solved;
the paper's are over those that both of its methods solved. SPL is success weighted by path length, with
the reference path by which the authors measured their agent.

In "any" the tool starts 8 to 14 cm from the object in any direction, in "behind" 9 cm straight behind it
as seen from the goal. The paper's text says that the start is "sampled around the object", its authors'
code has it straight behind. Contact, collisions and SPL depend on it, so that the printed figures stand
beside both.
"""


def rows_of(method: str, evaluation_set: str) -> pd.DataFrame:
    """The rows of an agent or a controller on a set."""
    name = f"{evaluation_set.replace('/', '_')}.csv.gz"
    if method in AGENTS:
        return pd.read_csv(AGENTS[method] / name)
    return pd.read_csv(PAPER_FOLDER / "rows" / f"{method}_{name}")


def mean_of(rows: pd.DataFrame, metric: str) -> float:
    """Mean over all episodes, or over the solved ones, as in all tables."""
    chosen = rows if metric in OVER_ALL else rows[rows["success"]]
    return float(chosen[metric].mean())


def number(value: float) -> str:
    """Three decimals, and as many leading digits as it takes."""
    return "–" if pd.isna(value) else f"{value:.3f}" if abs(value) < 10 else f"{value:.0f}"


def beside_paper_table() -> str:
    """Both agents beside the paper's, each metric as the authors measured it, for both starts."""
    lines = [("set", "tool's start", "episodes", *COLUMNS.values())]
    for name, label in SETS.items():
        for prefix, start in STARTS.items():
            ours = {agent: rows_of(agent, f"{prefix}{name}") for agent in AGENTS}
            cells = [_beside(metric, name, ours) for metric in COLUMNS]
            count = min(len(rows) for rows in ours.values())
            lines.append((label, start, str(count), *cells))
    return _markdown(lines)


def success_table() -> str:
    """Success of both agents for both starts, beside the paper's agent and controller."""
    heads = [f"`{agent}`, {start}" for agent in AGENTS for start in STARTS.values()]
    lines = [("set", *heads, "paper's agent", "paper's controller")]
    for name, label in SETS.items():
        if name.startswith("hard/"):
            continue
        cells = [
            number(mean_of(rows_of(agent, f"{prefix}{name}"), "success"))
            for agent in AGENTS
            for prefix in STARTS
        ]
        lines.append((label, *cells, *map(number, PAPER[name].success)))
    return _markdown(lines)


def _beside(metric: str, name: str, ours: dict[str, pd.DataFrame]) -> str:
    """Ours, with the difference to the printed figure, and the printed figure."""
    figures = PAPER[name]
    pair = getattr(figures, metric)
    column = measured_as(name, of_controller=False)[metric]
    cells = []
    for rows in ours.values():
        mean = mean_of(rows, column)
        difference = None if pair is None else round(mean, 3) - pair[0]
        cells.append(number(mean) + ("" if difference is None else f" ({_signed(difference)})"))
    printed = number(pair[0]) if pair else "–"
    printed += " of 50" if name.startswith("hard200") and pair else ""
    retrained = (figures.retrained or {}).get(metric)
    return " / ".join([*cells, printed]) + (f", retrained {retrained:.3f}" if retrained else "")


def _signed(value: float) -> str:
    return "±0" if abs(value) < 5e-4 else f"{value:+.3f}".replace("-", "−")


def stricter_table() -> str:
    """Our own, stricter figures and the smoothness of motion of the agents."""
    lines = [("set", "tool's start", *STRICTER.values())]
    for name, label in SETS.items():
        for prefix, start in STARTS.items():
            rows = [rows_of(agent, f"{prefix}{name}") for agent in AGENTS]
            cells = [" / ".join(number(mean_of(r, metric)) for r in rows) for metric in STRICTER]
            lines.append((label, start, *cells))
    return _markdown(lines)


def controller_table() -> str:
    """The controllers, each metric as the authors measured theirs, for both starts."""
    columns = ("success", "contact_rate", "collision_rate", "spl", "path_length")
    heads = ("success", "contact", "collision of object or arm", "SPL", "path (m)")
    faithful = ("by the authors' rules: success", "SPL")
    lines = [("set", "tool's start", "episodes", *heads, *faithful)]
    for name in (*SETS, "hard_wide/small_cube"):
        for prefix, start in STARTS.items():
            if prefix and name not in SETS:
                continue
            own = rows_of("corridor", f"{prefix}{name}")
            theirs = rows_of("corridor_faithful", f"{prefix}{name}")
            as_there = measured_as(name, of_controller=True)
            cells = [number(mean_of(own, as_there[metric])) for metric in columns]
            cells += [number(mean_of(theirs, as_there[metric])) for metric in ("success", "spl")]
            lines.append((f"`{name}`", start, str(len(own)), *cells))
    return _markdown(lines)


def verdict_table(agent: str) -> str:
    """Verdicts against the paper's agent by set and start, from what `modpush reproduce` judged."""
    judged = pd.concat(
        pd.read_csv(VERDICTS[agent] / f"{part}_verdicts.csv")
        for part in ("free", "obstacles", "hard")
    )
    judged = judged[judged["versus"].str.startswith("paper: agent")]
    judged = judged[judged["method"].str.startswith("agent")]
    lines = [("set", "tool's start", "against", "ahead", "level", "behind")]
    for (name, method, versus), own in judged.groupby(["set", "method", "versus"], sort=False):
        words = {
            verdict: ", ".join(COLUMNS[m] for m in own.loc[own["verdict"] == verdict, "metric"])
            for verdict in ("ahead", "level", "behind")
        }
        against = versus.removeprefix("paper: ").replace("agent", "the paper's agent")
        against = f"ours retrained, {against}" if method == "agent_retrained" else against
        start = "behind" if name.startswith("behind/") else "any"
        lines.append((SETS[paper_set(name)], start, against, *words.values()))
    return _markdown(lines)


def _markdown(lines: list[tuple[str, ...]]) -> str:
    head, *body = (f"| {' | '.join(line)} |" for line in lines)
    return "\n".join([head, "|" + "---|" * len(lines[0]), *body]) + "\n"


BLOCKS = {
    "success": success_table,
    "agents": lambda: beside_paper_table() + ABOUT,
    "stricter": stricter_table,
    "controllers": controller_table,
    "verdicts any_object": lambda: verdict_table("any_object"),
    "verdicts small_cube": lambda: verdict_table("small_cube"),
}
"""What stands between `<!-- results: NAME -->` and `<!-- end -->`."""
PAGES = ("README.md", "docs/agents.md", "docs/evaluation.md")


def keep_tables(evaluated: Path) -> None:
    """Copy tables by family, and the agents' rows, as far as a folder of `modpush evaluate` has them."""
    places = {"small_cube": "agent/", "any_object": "any_object/"}
    places |= {name: f"baseline/{name}_" for name in ("corridor", "corridor_faithful")}
    for policy, place in places.items():
        for name in (*EVALUATION_SETS, *BEHIND_SETS):
            found, kept = (
                evaluated / policy / name,
                f"{ROOT}/docs/results/{place}{name.replace('/', '_')}",
            )
            if not (found / "table.md").is_file():
                continue
            text = (found / "table.md").read_text(encoding="utf-8")
            if policy in AGENTS:
                text += "\n" + (found / "beside_paper.md").read_text(encoding="utf-8")
                rows = gzip.compress((found / "episodes.csv").read_bytes(), mtime=0)
                (AGENTS[policy] / f"{name.replace('/', '_')}.csv.gz").write_bytes(rows)
            Path(f"{kept}.md").write_text(text, encoding="utf-8")


def rewrite(text: str, names: Collection[str] = tuple(BLOCKS)) -> str:
    """A page with its tables written again, those of these names.

    Raises:
        ValueError: If a page asks for a table that there is not.
    """

    def block(found: re.Match[str]) -> str:
        if found[1] not in BLOCKS:
            raise ValueError(f"results: must be one of {sorted(BLOCKS)}, got {found[1]!r}.")
        if found[1] not in names:
            return found[0]
        return f"<!-- results: {found[1]} -->\n\n{BLOCKS[found[1]]()}\n<!-- end -->"

    return re.sub(r"<!-- results: ([\w ]+) -->\n.*?<!-- end -->", block, text, flags=re.DOTALL)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description="Write the tables of results into the pages.")
    parser.add_argument(
        "tables", nargs="*", help=f"tables to write, of {list(BLOCKS)}; all if none"
    )
    parser.add_argument("--copy", nargs="+", type=Path, default=[], metavar="FOLDER")
    args = parser.parse_args()
    for folder in args.copy:
        keep_tables(folder)
    for page in PAGES:
        path = ROOT / page
        text = rewrite(path.read_text(encoding="utf-8"), args.tables or tuple(BLOCKS))
        path.write_text(text, encoding="utf-8")
        print(f"Wrote {page}.")
