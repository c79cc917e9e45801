import io

import numpy as np
import pandas as pd
import pytest

from modpush.evaluation.published_results import PAPER, beside_paper
from modpush.evaluation.sets import EVALUATION_SETS
from modpush.evaluation.tables import compare, format_table, summarize, to_display


def rows(success: list[int], **columns: list[float]) -> pd.DataFrame:
    n = len(success)
    names = ("", "_object", "_arm", "_at_end", "_object_at_end")
    names = (*(f"collision_rate{name}" for name in names), "mean_jerk", "reversal_rate", "steps")
    data = {name: [0.0] * n for name in names} | columns
    return pd.DataFrame(
        {
            "episode": range(n),
            "scene": "slot",
            "success": np.array(success, dtype=bool),
            "spl": np.array(success) * 0.5,
            "spl_authors_agent": np.array(success) * 0.6,
            "spl_authors_controller": np.array(success) * 0.7,
            "contact_rate_at_end": np.array(columns["contact_rate"]) / 2,
            **data,
        }
    )


A = rows([1, 1, 1, 0], contact_rate=[0.8, 0.6, 0.1, 0.0], path_length=[0.4, 0.6, 9.0, 9.0])
B = rows([1, 1, 0, 1], contact_rate=[0.4, 0.4, 0.0, 0.2], path_length=[0.4, 0.5, 9.0, 9.0])


def test_success_is_over_all_and_the_rest_over_what_both_solved() -> None:
    table = summarize({"a": A, "b": B})
    assert table.loc["a", "success"] == pytest.approx(0.75)
    assert table.loc["a", "spl"] == pytest.approx(0.375)
    assert table["solved"].tolist() == [2, 2]  # the first two episodes
    assert table.loc["a", "contact_rate"] == pytest.approx(0.7)
    assert table.loc["a", "contact_rate_std"] == pytest.approx(np.sqrt(0.02))  # (0.1^2 + 0.1^2) / 1
    assert table.loc["b", "path_length"] == pytest.approx(0.45)
    assert table.loc["a", "success_low"] < 0.75 < table.loc["a", "success_high"]


def test_alone_a_method_is_measured_over_what_it_solved() -> None:
    assert summarize({"a": A}).loc["a", "contact_rate"] == pytest.approx(0.5)
    nothing = summarize({"a": rows([0, 0], contact_rate=[1.0, 1.0], path_length=[1.0, 1.0])})
    assert nothing.loc["a", "solved"] == 0
    assert np.isnan(nothing.loc["a", "contact_rate"])
    assert "–" in to_display(nothing)["contact_rate"].item()


def test_compare_pairs_the_episodes() -> None:
    table = compare(A, B)
    assert table.loc["success", "count"] == 4
    assert table.loc["contact_rate", "count"] == 2
    # differences 0.4 and 0.2: mean 0.3, sd 0.1414, d = 2.1213, t = 3
    assert table.loc["contact_rate", "difference"] == pytest.approx(0.3)
    assert table.loc["contact_rate", "effect_size"] == pytest.approx(2.1213, abs=1e-4)
    assert table.loc["contact_rate", "t"] == pytest.approx(3.0)
    # With one degree of freedom p is 1 - 2 / pi * atan(3) = 0.2048.
    assert table.loc["contact_rate", "p"] == pytest.approx(0.2048, abs=1e-4)
    assert not table.loc["contact_rate", "significant"]
    assert compare(A, B, level=0.21).loc["contact_rate", "significant"]
    assert table.loc["collision_rate", "p"] == 1.0


def test_other_episodes_are_not_compared() -> None:
    with pytest.raises(ValueError, match="'first' has 4 and 'second' 3"):
        compare(A, B.head(3))
    with pytest.raises(ValueError, match="that ran the same episodes"):
        summarize({"a": A, "b": B.assign(episode=[0, 1, 2, 4])})
    with pytest.raises(ValueError, match="at least one method, got none"):
        summarize({})
    with pytest.raises(ValueError, match="rows of 'a' must be of one episode or more"):
        summarize({"a": A.head(0)})


def test_tables_in_three_formats() -> None:
    table = summarize({"a_1": A})
    markdown = format_table(to_display(table))
    head, rule, line = markdown.splitlines()
    assert head.count("|") == rule.count("|") == line.count("|")
    assert line.startswith("| a_1 | 4 | 0.750 [0.250, 1.000] | 0.375 [0.125, 0.500] | 0.450 [")
    assert "| 3 | 0.500 ± " in line
    latex = format_table(to_display(table), "latex")
    assert r"a\_1 & 4 & 0.750 [0.250, 1.000]" in latex
    assert r"$\pm$" in latex
    assert latex.count(r"\\") == 2
    again = pd.read_csv(io.StringIO(format_table(table, "csv")), index_col=0)
    pd.testing.assert_frame_equal(again, table)
    with pytest.raises(ValueError, match="how must be 'markdown', 'latex' or 'csv'"):
        format_table(table, "word")  # type: ignore[arg-type]


def test_the_papers_figures_stand_beside_ours() -> None:
    table = beside_paper(summarize({"corridor": A}), "obstacles/small_cube")
    assert list(table.columns) == ["corridor", "paper_controller", "paper_agent"]
    assert table.loc["success"].tolist() == [0.75, 0.955, 0.980]
    # Each figure stands where it is measured alike: contact at the steps' ends, SPL by its own path.
    assert table.loc["contact_rate_at_end", ["paper_controller", "paper_agent"]].tolist() == [
        0.850,
        0.995,
    ]
    assert table.loc["contact_rate", ["paper_controller", "paper_agent"]].isna().all()
    # The authors count the collisions of the object alone for their agent.
    assert table.loc["collision_rate_object_at_end", "paper_agent"] == 0.008
    assert table.loc["collision_rate_at_end", "paper_controller"] == 0.011
    assert table["paper_agent"].notna().sum() == table["paper_controller"].notna().sum() == 5
    assert table.loc["spl_authors_agent", "paper_agent"] == 0.910
    assert table.loc["spl_authors_controller", "paper_controller"] == 0.952
    assert table.loc["spl"].isna().sum() == 2
    free = beside_paper(summarize({"corridor": A}), "free/small_cube")
    assert np.isnan(free.loc["collision_rate_object_at_end", "paper_agent"])
    # In free space the authors measured both methods by Lazy Theta*.
    assert free.loc["spl_authors_agent", ["paper_controller", "paper_agent"]].tolist() == [
        0.918,
        0.928,
    ]
    assert np.isnan(free.loc["spl_authors_controller", "paper_controller"])
    behind = beside_paper(summarize({"corridor": A}), "behind/free/small_cube+rod")
    pd.testing.assert_frame_equal(behind, free)
    assert beside_paper(summarize({"corridor": A}), "smoke")["paper_agent"].isna().all()


def test_every_set_of_the_paper_has_its_figures() -> None:
    assert set(PAPER) == set(EVALUATION_SETS) - {"hard_wide/small_cube"}
    for figures in PAPER.values():
        for agent, controller in (figures.success, figures.spl, figures.contact_rate):
            assert 0.5 <= agent <= 1
            assert 0.5 <= controller <= 1


def test_the_retrained_agent_s_figures_stand_beside_the_others() -> None:
    table = beside_paper(summarize({"corridor": A}), "obstacles/fragment")
    assert table.loc["success", ["paper_agent", "paper_retrained"]].tolist() == [0.867, 0.959]
    assert table.loc["spl_authors_agent", "paper_retrained"] == 0.83
    assert table["paper_retrained"].dropna().tolist() == [0.959, 0.83, 0.984, 0.01, 0.58]
    assert "paper_retrained" not in beside_paper(summarize({"corridor": A}), "hard/small_cube")


def test_standard_deviations_are_printed_for_what_the_paper_prints_them() -> None:
    for figures in PAPER.values():
        assert (figures.collision_rate is None) == (figures.collision_rate_std is None)
        assert len(figures.contact_rate_std) == len(figures.path_length_std) == 2
        assert {*figures.significant} <= {"contact_rate", "collision_rate", "path_length"}
    assert PAPER["free/small_cube"].episodes == 500


def test_names_are_escaped_in_latex_and_markdown() -> None:
    table = pd.DataFrame({"value": ["1"]}, index=[r"a_b^2~{c}|\d"])
    assert r"a\_b\^{}2\~{}\{c\}|\textbackslash{}d & 1" in format_table(table, "latex")
    assert r"a_b^2~{c}\|\d | 1 |" in format_table(table)
