"""The first page of `docs/results/paper`: what is there, and where we are ahead, level and behind."""

import re
from pathlib import Path

import pandas as pd

from modpush.files import write_text
from modpush.reproduction.config import PARTS, ReproduceConfig
from modpush.reproduction.measure import AGENT
from modpush.reproduction.verdicts import RULES

__all__ = ["verdict_lists", "write_companion"]

_ABOUT = {
    "free": "Table II: straight pushes in free space",
    "obstacles": "Table III: five families of obstacles, four objects",
    "hard": "Table IV: unseen scenes, dense with clutter",
    "examples": "Fig. 4: episodes of the agent and the controller",
    "runtime": "The paper's computing times (Sec. V-B)",
    "dynamics": "Dynamics that the agent was not trained with",
    "ablations": "What the parts of the method are worth (Sec. IV)",
    "further": "Short further training in the hard scenes (Sec. V-C)",
}
_OTHER_PAGES = (
    ("claims.md", "What the paper's text claims", ", claim by claim, beside what was found here."),
    (
        "training/README.md",
        "The paper's own configuration",
        ", as far as it was trained, beside `cpu`.",
    ),
    ("retrained/README.md", "The agent trained further with the fragment", ", and its weights."),
)
"""Pages that are written by hand: file, label and the rest of the sentence."""
_PART_OF = {f"{start}hard/small_cube": f"{start}hard200/small_cube" for start in ("", "behind/")}
"""Sets whose episodes are the first of another one."""


def write_companion(config: ReproduceConfig) -> None:
    """Write `README.md` from the pages and verdicts that the folder holds."""
    found = [part for part in PARTS if (config.out / f"{part}.md").exists()]
    lines = [
        "# The paper, reproduced",
        "Every page has the command that makes it again, the seed, the machine, the time it took and, "
        "if it was made in a git checkout, the commit. `modpush reproduce all` makes all of them, but "
        "`ablations` and `further` only once their sweeps have been run. Episodes that were run are "
        "kept in `runs/reproduce`, so that only missing ones run again.",
        "`agent` is the agent that a command names with `--agent`, `small_cube` where it names none: "
        "trained with the small cube alone. `agent_retrained` is the agent that `--policy-files "
        "fragment` names, trained with the fragment as well. The shipped agents move on where they have "
        "come to rest before the goal (docs/evaluation.md); `--recovery False` measures them without.",
        "\n".join(
            ["| page | what | command |", "|---|---|---|"]
            + [
                f"| [{part}]({part}.md) | {_ABOUT[part]} | {_command_of(config.out, part)} |"
                for part in found
            ]
        ),
    ]
    lines += [
        f"[{label}]({file}){rest}"
        for file, label, rest in _OTHER_PAGES
        if (config.out / file).exists()
    ]
    if missing := [_ABOUT[part] for part in PARTS if part not in found]:
        lines.append("Not there yet: " + "; ".join(missing) + ".")
    if found_verdicts := _read_verdicts(config.out):
        verdicts = pd.concat(found_verdicts, ignore_index=True)
        lines.append("## Ahead, level, behind\n\n" + RULES.strip())
        lines += _cut_sets(verdicts)
        lines += verdict_lists(verdicts)
    write_text(config.out / "README.md", "\n\n".join(lines) + "\n")


def _command_of(out: Path, part: str) -> str:
    """The command that a page says it was made with."""
    (command,) = re.findall(
        r"^\| command \| (.+) \|$", (out / f"{part}.md").read_text(encoding="utf-8"), re.M
    )
    return str(command)


def _read_verdicts(out: Path) -> list[pd.DataFrame]:
    paths = [out / f"{part}_verdicts.csv" for part in PARTS]
    return [pd.read_csv(path) for path in paths if path.exists()]


def _cut_sets(verdicts: pd.DataFrame) -> list[str]:
    """A warning if not all episodes of a set were run."""
    sets = verdicts[["set", "episodes", "episodes_of_set"]].drop_duplicates()
    cut = sets[sets["episodes"] < sets["episodes_of_set"]]
    if cut.empty:
        return []
    counts = ", ".join(
        f"{r.episodes} of {r.episodes_of_set} of `{r.set}`" for r in cut.itertuples()
    )
    return [f"**Only the first episodes were run: {counts}.** The verdicts are of these alone."]


def verdict_lists(verdicts: pd.DataFrame) -> list[str]:
    """The agents' verdicts as Markdown: counts, and a list each of what is ahead, level and behind.

    Args:
        verdicts: Columns of `judge`, and `table`, `section` and `set`.

    Returns:
        Paragraphs. Rows of the controllers are left out: the lists are about the agents. The counts
        are of each start of the tool, and leave out a set whose episodes are part of another one that is
        there.
    """
    agents = verdicts[verdicts["method"].str.startswith(AGENT)]
    paragraphs = []
    behind = agents["set"].str.startswith("behind/")
    starts = {"in any direction from": agents[~behind], "straight behind": agents[behind]}
    for start, chosen in starts.items():
        if len(chosen):
            paragraphs += [f"The tool starts {start} the object:"] if behind.any() else []
            paragraphs += _count_verdicts(chosen)
    for verdict in ("ahead", "level", "behind"):
        chosen = agents[agents["verdict"] == verdict]
        lines = [
            f"- {table}, {section}, {method} against {versus}: "
            + ", ".join(f"{r.ours} {r.mean:.3f} ({r.theirs:.3f})" for r in own.itertuples())
            for (table, section, method, versus), own in chosen.groupby(
                ["table", "section", "method", "versus"], sort=False
            )
        ]
        paragraphs.append(f"### {verdict.capitalize()}")
        paragraphs.append("\n".join(lines) or "Nothing.")
    return paragraphs


def _count_verdicts(agents: pd.DataFrame) -> list[str]:
    """How many verdicts there are of each agent against each method, as a table."""
    sets = set(agents["set"])
    part_of = {part: whole for part, whole in _PART_OF.items() if {part, whole} <= sets}
    counted = agents[~agents["set"].isin(part_of)]
    counts = counted.groupby(["method", "versus", "verdict"], sort=False).size()
    table = counts.unstack(fill_value=0).reindex(columns=["ahead", "level", "behind"], fill_value=0)
    lines = ["| | against | ahead | level | behind |", "|---|---|---|---|---|"]
    lines += [
        f"| {method} | {versus} | {row.ahead} | {row.level} | {row.behind} |"
        for (method, versus), row in table.iterrows()
    ]
    texts = [
        f"The episodes of `{part}` are the first of `{whole}` and not counted again."
        for part, whole in part_of.items()
    ]
    return ["\n".join(lines), *texts]
