"""Figures, tests and examples from rows made by hand."""

import itertools

import numpy as np
import pandas as pd
import pytest
from scipy import stats

from modpush.evaluation.sets import BEHIND_SETS, EVALUATION_SETS, EvaluationSet, load_set
from modpush.reproduction.ablations import ablation_table
from modpush.reproduction.cells import make_cells, make_tests
from modpush.reproduction.companion import verdict_lists
from modpush.reproduction.example_pictures import choose_examples
from modpush.reproduction.paper_tables import PAPER_TABLES, _display, _section_text, _test_verdicts
from modpush.reproduction.printed import judge, printed_rows


def rows(success: list[int], contact: list[float], path: list[float]) -> pd.DataFrame:
    return pd.DataFrame(
        {
            "episode": range(len(success)),
            "scene": "slot",
            "success": np.array(success, dtype=bool),
            "spl": np.array(success) * 0.5,
            "contact_rate": contact,
            "collision_rate": 0.0,
            "path_length": path,
            "shortest_length": 0.4,
        }
    )


AGENT = rows([1, 1, 1, 0], [0.8, 0.6, 0.1, 0.0], [0.4, 0.6, 9.0, 9.0])
CORRIDOR = rows([1, 1, 0, 1], [0.4, 0.4, 0.0, 0.2], [0.4, 0.5, 9.0, 9.0])
FAITHFUL = rows([1, 0, 1, 0], [0.2, 0.0, 0.3, 0.0], [0.4, 9.0, 0.8, 9.0])
ROWS = {"agent": AGENT, "corridor": CORRIDOR, "corridor_faithful": FAITHFUL}


def test_a_cell_is_over_what_both_methods_of_its_pair_solved() -> None:
    cells = make_cells(ROWS).set_index(["method", "metric"])
    # The agent and the corridor solved 0 and 1, the agent and the faithful one 0 and 2.
    assert cells.loc[("agent", "contact_rate"), "mean"] == pytest.approx(0.7)
    assert cells.loc[("corridor", "contact_rate"), "mean"] == pytest.approx(0.4)
    assert cells.loc[("corridor_faithful", "contact_rate"), "mean"] == pytest.approx(0.25)
    assert cells.loc[("agent", "contact_rate"), "std"] == pytest.approx(np.sqrt(0.02))
    assert cells["pair"].groupby("method").first().to_dict() == {
        "agent": "corridor",
        "corridor": "agent",
        "corridor_faithful": "agent",
    }
    success = cells.loc[("agent", "success")]
    assert success["mean"] == 0.75
    assert success["count"] == 4
    # Wilson's interval of 3 in 4, by its formula: (p + z²/2n ± z sqrt(p(1-p)/n + z²/4n²)) / (1 + z²/n)
    assert (success["low"], success["high"]) == pytest.approx((0.3006, 0.9544), abs=1e-4)


def test_the_tests_are_those_of_scipy_over_the_pair() -> None:
    tests = make_tests(ROWS).set_index(["second", "metric"])
    contact = tests.loc[("corridor", "contact_rate")]
    assert contact["p"] == pytest.approx(stats.ttest_rel([0.8, 0.6], [0.4, 0.4]).pvalue)
    assert contact["effect_size"] == pytest.approx(2.1213, abs=1e-4)  # 0.3 / 0.1414
    assert contact["count"] == 2
    assert tests.loc[("corridor_faithful", "success"), "count"] == 4
    assert set(tests["verdict"]) == {"level"}
    with pytest.raises(ValueError, match="'agent' has 4 and 'corridor' 3"):
        make_tests({"agent": AGENT, "corridor": CORRIDOR.head(3)})


def test_the_tables_have_every_set_of_the_paper_with_both_starts_of_the_tool() -> None:
    sections = [section for table in PAPER_TABLES.values() for section in table.sections]
    names = [section.evaluation_set for section in sections]
    assert set(names) == {*EVALUATION_SETS, *BEHIND_SETS}
    for any_start, behind in itertools.pairwise(sections):
        if behind.evaluation_set in BEHIND_SETS:
            assert behind.evaluation_set == f"behind/{any_start.evaluation_set}"
            assert behind.printed == any_start.printed


def test_what_no_pair_solved_is_left_open() -> None:
    tests = make_tests({"agent": AGENT, "corridor": CORRIDOR.assign(success=False)})
    section = PAPER_TABLES["free"].sections[0]
    text = _section_text(section, pd.DataFrame({"method": ["agent"]}).set_index("method"), tests, 4)
    assert "| contact_rate | 0 | – | – | – | – | level |" in text
    judged = _test_verdicts(tests)
    assert set(judged["metric"]) == {"success", "spl"}


def test_printed_figures_stand_beside_what_is_measured_as_there() -> None:
    # Fifteen times the same: fewer than 30 episodes that both solved would not be judged.
    many = {name: pd.concat([frame] * 15, ignore_index=True) for name, frame in ROWS.items()}
    as_there = {
        name: frame.assign(
            spl_authors_agent=0.4,
            spl_authors_controller=0.6,
            contact_rate_at_end=0.1,
            collision_rate_at_end=0.2,
            collision_rate_object_at_end=0.1,
        )
        for name, frame in many.items()
    }
    judged = judge(make_cells(as_there), "obstacles/fragment")
    assert set(judged["versus"]) == {
        "paper: agent",
        "paper: controller",
        "paper: agent, retrained",
    }
    ours = judged[judged["method"] == "agent"].set_index(["versus", "metric"])["ours"]
    assert ours["paper: agent"].to_dict() == {
        "success": "success",
        "contact_rate": "contact_rate_at_end",
        "collision_rate": "collision_rate_object_at_end",
        "spl": "spl_authors_agent",
    }
    assert ours[("paper: controller", "spl")] == "spl_authors_controller"
    assert ours[("paper: controller", "collision_rate")] == "collision_rate_at_end"
    assert ours[("paper: agent, retrained", "spl")] == "spl_authors_agent"
    # In free space the controller's staircase would be no way to be longer than: it was Lazy Theta*'s.
    free = judge(make_cells(as_there), "free/small_cube").set_index(["method", "versus", "metric"])
    assert free.loc[("agent", "paper: controller", "spl"), "ours"] == "spl_authors_agent"
    assert set(judge(make_cells(ROWS), "obstacles/fragment")["metric"]) == {"success"}
    plain = judge(make_cells(many), "obstacles/fragment")
    assert {"spl", "contact_rate"} <= set(plain["ours"])
    assert judge(make_cells(many), None).empty
    retrained = printed_rows("obstacles/fragment")[2]
    assert list(retrained.figures.values()) == [0.959, 0.984, 0.01, 0.83, 0.58]
    assert retrained.stds == {"contact_rate": 0.05, "collision_rate": 0.05, "path_length": 0.23}
    assert printed_rows("hard200/small_cube")[1].episodes == 50


def test_agents_are_judged_against_those_that_were_trained_alike() -> None:
    cells = make_cells({"agent": AGENT, "agent_retrained": CORRIDOR, "corridor": FAITHFUL})
    pairs = judge(cells, "obstacles/fragment").groupby("method")["versus"].unique().map(set)
    assert pairs["agent"] == {"paper: agent", "paper: controller"}
    assert pairs["agent_retrained"] == {"paper: agent, retrained", "paper: controller"}
    # Without a retrained agent, the one that there is may be either.
    alone = judge(make_cells(ROWS), "obstacles/fragment")
    assert (
        set(alone[alone["method"] == "agent"]["versus"])
        == pairs["agent"] | pairs["agent_retrained"]
    )
    # Without a retrained row in the paper, both stand beside its agent.
    assert set(judge(cells, "obstacles/large_cube")["versus"]) == pairs["agent"]
    assert {"agent", "agent_retrained"} <= set(judge(cells, "obstacles/large_cube")["method"])


def test_the_printed_deviations_stand_beside_the_means() -> None:
    section = PAPER_TABLES["hard"].sections[1]
    shown = _display(make_cells(ROWS), section)
    assert shown.loc["paper: agent", "contact"] == "0.977 ± 0.06"
    assert shown.loc["paper: agent", "success"] == "0.88"
    assert shown["episodes"].tolist() == ["4", "4", "4", "50", "50"]


def test_verdicts_are_counted_by_agent_and_once() -> None:
    def line(evaluation_set: str, method: str, versus: str, verdict: str) -> dict[str, object]:
        about = {"table": "hard", "section": evaluation_set, "set": evaluation_set}
        figures = {"ours": "success", "mean": 0.5, "theirs": 0.5}
        return about | {"method": method, "versus": versus, "verdict": verdict} | figures

    verdicts = pd.DataFrame(
        [
            line("hard/small_cube", "agent", "paper: agent", "level"),
            line("hard200/small_cube", "agent", "paper: agent", "ahead"),
            line("obstacles/fragment", "agent_retrained", "paper: agent", "behind"),
            line("obstacles/fragment", "corridor", "paper: agent", "behind"),
        ]
    )
    table, note, *lists = verdict_lists(verdicts)
    assert table.splitlines()[2:] == [
        "| agent | paper: agent | 1 | 0 | 0 |",
        "| agent_retrained | paper: agent | 0 | 0 | 1 |",
    ]
    assert "`hard/small_cube` are the first of `hard200/small_cube`" in note
    assert any("hard/small_cube, agent against paper: agent: success" in text for text in lists)
    behind = [line("behind/hard/small_cube", "agent", "paper: agent", "behind")]
    both = verdict_lists(pd.concat([verdicts, pd.DataFrame(behind)], ignore_index=True))
    assert both[:3] == ["The tool starts in any direction from the object:", table, note]
    assert both[3] == "The tool starts straight behind the object:"
    assert both[4].splitlines()[2:] == ["| agent | paper: agent | 0 | 0 | 1 |"]
    alone = verdict_lists(verdicts[verdicts["set"] == "hard/small_cube"])
    assert "| agent | paper: agent | 0 | 1 | 0 |" in alone[0]
    assert alone[1] == "### Ahead"


def test_examples_are_chosen_by_the_rule() -> None:
    scenarios = load_set("obstacles/small_cube").scenarios[:5]
    episodes = EvaluationSet(name="five", scenarios=scenarios)
    straight = [np.hypot(*np.subtract(s.object_pose[:2], s.goal_position)) for s in scenarios]
    agent = pd.DataFrame(
        {
            "episode": range(5),
            "scene": ["a", "a", "a", "b", "b"],
            "success": [True, True, True, True, False],
            # Nothing stands in the way of 0 and 4.
            "shortest_length": np.multiply(straight, [1.0, 1.2, 1.2, 1.2, 1.2]),
            "path_length": [0.5, 0.5, 0.5, 0.5, 0.5],
        }
    )
    controller = agent.assign(success=[True, False, True, True, True])
    controller["path_length"] = [0.9, 0.9, 0.5, 0.6, 0.9]
    # Of family a: 1 is not solved by both, so 2; of b: 3. Both solved 0, where 0.4 m were saved.
    assert choose_examples(agent, controller, episodes) == [2, 3, 0]


def test_ablations_are_compared_with_the_first_variant() -> None:
    final = {"base": [0.95, 0.97, 0.99], "uniform": [0.90, 0.94, 0.92], "off": [0.1, 0.2, 0.3]}
    trials = pd.DataFrame(
        [
            {
                "variant": variant,
                "group": "base" if variant == "base" else "others",
                "seed": seed,
                "state": "unfinished" if (variant, seed) == ("off", 2) else "finished",
                "final_success": value,
                "final_spl": 0.8,
                "final_contact_rate": 0.9,
                "final_collision_rate": 0.01,
            }
            for variant, values in final.items()
            for seed, value in enumerate(values)
        ]
    )
    curves = pd.DataFrame(
        [
            {"variant": v, "seed": s, "step": step, "success": value * step / 200}
            for v, values in final.items()
            for s, value in enumerate(values)
            for step in (100, 200)
        ]
    )
    table = ablation_table(trials, curves).droplevel("group")
    assert table["success"].to_dict() == pytest.approx({"base": 0.97, "uniform": 0.92, "off": 0.15})
    assert table["seeds"].to_dict() == {"base": 3, "uniform": 3, "off": 2}
    assert table["area"]["uniform"] == pytest.approx(0.75 * 0.92)
    assert table["steps_to_0.9"].to_dict() == pytest.approx(
        {"base": 200, "uniform": 200, "off": np.nan}, nan_ok=True
    )
    expected = stats.ttest_rel(final["uniform"], final["base"]).pvalue
    assert table["p"]["uniform"] == pytest.approx(expected)
    assert table["difference"]["off"] == pytest.approx(-0.81)  # of the two seeds that are finished
    assert np.isnan(table[["p", "effect_size"]].loc["off"]).all()  # two seeds tell nothing
    assert np.isnan(table["difference"]["base"])
    with pytest.raises(ValueError, match="no trial of 'base', the first variant, is finished"):
        ablation_table(trials.assign(state="failed"), curves)
