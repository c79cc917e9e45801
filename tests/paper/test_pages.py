"""`modpush reproduce` with the real agent, controllers and environments, for a few episodes."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import pandas as pd
import pytest

from modpush.envs.scenes.conditions import EpisodeConditions
from modpush.recipes.methods import get_method
from modpush.reproduction import PAPER_TABLES, PARTS, ReproduceConfig, reproduce
from modpush.reproduction.dynamics import QUANTITIES, Change

pytestmark = pytest.mark.filterwarnings("ignore:Precision loss occurred:RuntimeWarning")


def test_a_table_is_written_resumed_and_listed(tmp_path: Path) -> None:
    config = ReproduceConfig(
        parts=("free",),
        first=2,
        rows=tmp_path / "rows",
        out=tmp_path / "out",
        progress=False,
    )
    reproduce(config)
    page = (config.out / "free.md").read_text()
    assert "`modpush reproduce free --first 2`" in page
    assert "The first 2 of 500 episodes." in page
    assert "| paper: agent | 500 | 1 | – | 0.943 ± 0.13 | " in page
    assert "Agent minus `corridor_faithful`, paired t-tests:" in page
    assert r"\begin{tabular}" in (config.out / "free.tex").read_text()
    cells = pd.read_csv(config.out / "free_cells.csv").set_index(["set", "method", "metric"])
    for name in ("free/small_cube", "behind/free/small_cube"):
        rows = pd.read_csv(config.out / "rows" / f"agent_{name.replace('/', '_')}.csv.gz")
        assert cells.loc[(name, "agent", "success"), "mean"] == rows["success"].mean()
        assert cells.loc[(name, "agent", "spl"), "mean"] == pytest.approx(rows["spl"].mean())
    companion = (config.out / "README.md").read_text()
    assert "[free](free.md)" in companion
    assert "\n4. Path lengths are not judged against printed ones" in companion
    assert "are means over fewer than 30 episodes" in companion
    assert "Not there yet: Table III" in companion
    assert "| `modpush reproduce free --first 2` |" in companion
    cut = "2 of 500 of `free/small_cube`, 2 of 500 of `behind/free/small_cube`"
    assert f"**Only the first episodes were run: {cut}.**" in companion
    verdicts = pd.read_csv(config.out / "free_verdicts.csv")
    agents = verdicts[verdicts["method"] == "agent"]
    for verdict in ("ahead", "level", "behind"):
        assert companion.count(f"### {verdict.capitalize()}") == 1
    assert len(agents) >= 8
    assert "(training/README.md)" not in companion

    (config.out / "training").mkdir()
    (config.out / "training" / "README.md").write_text("# A run\n")
    stored = config.rows / "sets" / "small_cube" / "free" / "small_cube" / "episodes.csv"
    before = stored.read_bytes()
    reproduce(replace(config, parts=("free",), first=3))
    assert stored.read_bytes().startswith(before)  # only the third was run
    assert stored.read_bytes().count(b"\n") == 4
    assert "minutes for 18 episodes, with `--workers 1`" in (config.out / "free.md").read_text()
    companion = (config.out / "README.md").read_text()
    assert companion.index("[free](free.md)") < companion.index("(training/README.md)")


@pytest.mark.slow
def test_the_other_pages_are_written(tmp_path: Path) -> None:
    config = ReproduceConfig(
        parts=("examples", "runtime", "dynamics"),
        first=5,
        dynamics_episodes=1,
        rows=tmp_path / "rows",
        out=tmp_path / "out",
        progress=False,
    )
    reproduce(config)
    table = pd.read_csv(config.out / "dynamics.csv")
    assert set(table["quantity"]) == set(QUANTITIES)
    values = sum(len(about.values) for about in QUANTITIES.values())
    assert (table["metric"] == "success").sum() == values
    # Nominal values are measured once, whatever is varied.
    assert table[table["nominal"]].groupby("metric")["mean"].nunique().max() <= 1
    times = pd.read_csv(config.out / "runtime.csv")
    assert (times["cpu_ms"] > 0).all()
    assert "action prediction of the network" in (config.out / "runtime.md").read_text()
    for name in ("examples", "runtime", "dynamics"):
        assert f"[{name}]({name}.md)" in (config.out / "README.md").read_text()
        assert (config.out / f"{name}.png").stat().st_size > 10_000


@pytest.mark.parametrize("quantity", QUANTITIES)
def test_a_change_reaches_scenario_or_environment(quantity: str) -> None:
    value = QUANTITIES[quantity].values[-1]
    assert QUANTITIES[quantity].nominal in QUANTITIES[quantity].values
    change = Change(quantity=quantity, value=value)
    nominal = Change(quantity=quantity, value=QUANTITIES[quantity].nominal)
    assert (change.name, nominal.name) == (f"{quantity}_{value:g}", "nominal")
    plain, changed = nominal.scenario(1, 0), change.scenario(1, 0)
    if quantity in ("mass", "friction"):
        assert getattr(changed.dynamics, quantity) == value
    elif quantity == "center_of_mass":
        x, y = changed.dynamics.center_of_mass
        assert (x * x + y * y) ** 0.5 == pytest.approx(value)
    elif quantity == "size":
        assert change.item.radius == pytest.approx(1.6 * nominal.item.radius)
        assert change.item.mass == nominal.item.mass
    elif quantity == "tip_height":
        assert change.item.tool_height == value
    if quantity != "size":
        assert changed.object_pose == plain.object_pose
        assert changed.goal_position == plain.goal_position
        assert changed.obstacles == plain.obstacles


@pytest.mark.parametrize("quantity", ["size", "tip_height", "control_freq", "depth_noise"])
def test_the_agent_acts_in_a_changed_environment(quantity: str) -> None:
    change = Change(quantity=quantity, value=QUANTITIES[quantity].values[-1])
    method = get_method("small_cube")
    env = change.make_env(1, method, EpisodeConditions())
    try:
        td = env.reset(scenarios=[change.scenario(1, 0)])
        td = env.step(method.make_policy()(td))
        assert td["next", "observation"].isfinite().all()
    finally:
        env.close()


@pytest.mark.parametrize(
    ("part", "field", "file"),
    [("ablations", "sweep", "ablations"), ("further", "further", "hard_further")],
)
def test_a_part_without_its_sweep_says_how_to_run_one(
    part: Any, field: str, file: str, tmp_path: Path
) -> None:
    config = ReproduceConfig(parts=(part,), rows=tmp_path / "rows", out=tmp_path / "out")
    with pytest.raises(FileNotFoundError, match=rf"no sweep in .*; run modpush sweep .*/{file}\."):
        reproduce(replace(config, **{field: tmp_path / "no"}))


def test_a_sweep_becomes_a_page_with_table_and_figure(tmp_path: Path) -> None:
    folder = tmp_path / "runs" / "hard_further"
    trials = pd.DataFrame(
        {
            "variant": ["before", "after"],
            "group": ["all", "further"],
            "seed": [0, 0],
            "state": ["finished", "finished"],
            "total_steps": [128, 50_000],
            "minutes": [0.5, 3.0],
            **{f"final_{name}": [0.5, 0.75] for name in ("success", "spl", "contact_rate")},
            "final_collision_rate": [0.1, 0.05],
        }
    )
    curves = trials[["variant", "group", "seed"]].assign(step=[128, 50_000], success=[0.5, 0.75])
    folder.mkdir(parents=True)
    trials.to_csv(folder / "trials.csv", index=False)
    curves.to_csv(folder / "curves.csv", index=False)
    config = ReproduceConfig(
        parts=("further",), further=folder, rows=tmp_path / "rows", out=tmp_path / "out"
    )
    reproduce(config)
    page = (config.out / "further.md").read_text()
    sweep = "modpush sweep examples/sweeps/hard_further.yaml --out runs/hard_further"
    assert f"--out runs/train; {sweep}" in page
    assert "0.750 (0.750 to 0.750)" in page
    assert "+0.250" in page
    assert (config.out / "further.png").stat().st_size > 10_000
    assert pd.read_csv(config.out / "further.csv")["success"].tolist() == [0.5, 0.75]
    assert "Short further training in the hard scenes" in (config.out / "README.md").read_text()
    assert "| seed | 0 |" in page
    assert "| time | 0.1 hours for 2 training runs" in page
    assert "All runs are finished." in page

    more = [
        trials.assign(seed=1, state=["finished", "failed"]),
        trials[1:].assign(variant="long", state="unfinished"),
    ]
    pd.concat([trials, *more]).to_csv(folder / "trials.csv", index=False)
    reproduce(config)
    page = (config.out / "further.md").read_text()
    assert "Of 5 runs 3 are finished, 1 failed; there is none yet of `long`." in page
    assert "| seed | 0, 1 |" in page


def test_parts_are_made_in_the_order_of_the_paper() -> None:
    assert ReproduceConfig(parts=("runtime", "free")).chosen == ("free", "runtime")
    assert ReproduceConfig().chosen == PARTS
    assert set(PAPER_TABLES) < set(PARTS)
    with pytest.raises(ValueError, match="parts"):
        ReproduceConfig(parts=("table4",))
    config = ReproduceConfig(first=3, policy_files={"fragment": Path("runs/f.safetensors")})
    assert config.command("obstacles") == (
        "modpush reproduce obstacles --first 3 --policy-files fragment runs/f.safetensors"
    )
    absolute = replace(config, policy_files={"fragment": Path.cwd() / "runs" / "f.safetensors"})
    assert absolute.command("obstacles") == config.command("obstacles")
    distant = replace(config, policy_files={"fragment": Path("/elsewhere/f.safetensors")})
    assert distant.command("obstacles").endswith("--policy-files fragment f.safetensors")
    assert config.command("free") == "modpush reproduce free --first 3"
    assert config.command("dynamics") == "modpush reproduce dynamics"
    own = replace(config, policy_files={"small_cube": Path("any_object")}, allow=("mine", "ours"))
    for part in ("free", "hard", "runtime"):
        assert "--policy-files small_cube any_object --allow mine ours" in own.command(part)
    assert own.command("examples") == "modpush reproduce examples --first 3 --allow mine ours"
    trained = replace(ReproduceConfig(), agent=str(Path.cwd() / "runs" / "train"))
    assert trained.command("free") == "modpush reproduce free --agent runs/train"
    hub = replace(ReproduceConfig(), agent="hf://owner/name")
    assert hub.command("free") == "modpush reproduce free --agent hf://owner/name"
    swept = replace(config, sweep=Path("/elsewhere/mine"))
    assert swept.command("ablations") == "modpush reproduce ablations --sweep runs/mine"
    elsewhere = replace(config, out=Path("/elsewhere"))
    assert elsewhere.command("dynamics") == "modpush reproduce dynamics"
    beside = replace(config, out=Path("docs/results/mine"))
    assert beside.command("dynamics") == "modpush reproduce dynamics --out docs/results/mine"


def test_agents_are_looked_up_before_an_episode_is_run(tmp_path: Path) -> None:
    def refused(message: str, **changes: Any) -> None:
        config = ReproduceConfig(
            parts=("free", "obstacles"), rows=tmp_path / "rows", out=tmp_path / "out", **changes
        )
        with pytest.raises(ValueError, match=message):
            reproduce(config)
        assert not list(tmp_path.rglob("episodes.csv"))

    refused(
        "policy_files must be of objects.*got .'fragmnt'",
        policy_files={"fragmnt": Path("any_object")},
    )
    refused("no 'nowhere'", policy_files={"fragment": Path("nowhere")})
    refused("no 'nowhere'", agent="nowhere")
