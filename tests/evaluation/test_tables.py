import numpy as np
import pandas as pd
import pytest

from modpush.evaluation.tables import compare, format_table, summarize, to_display


def rows(success: list[int], **columns: list[float]) -> pd.DataFrame:
    n = len(success)
    names = ("", "_object", "_arm", "_at_end")
    names = (*(f"collision_rate{name}" for name in names), "mean_jerk", "reversal_rate", "steps")
    data = {name: [0.0] * n for name in names} | columns
    return pd.DataFrame(
        {
            "episode": range(n),
            "scene": "slot",
            "success": np.array(success, dtype=bool),
            "spl": np.array(success) * 0.5,
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


def test_goal_poses_also_count_without_contact() -> None:
    more = {"final_yaw_error": [0.1] * 4, "collision_rate": [0.0, 0.01, 0.0, 0.0]}
    columns = {"contact_rate": [0.5] * 4, "path_length": [0.5] * 4}
    table = summarize({"a": rows([1, 1, 1, 0], **columns, **more)})
    assert table.loc["a", "success_without_contact"] == pytest.approx(0.5)
    assert to_display(table)["success_without_contact"].item().startswith("0.500 [")
    assert "success_without_contact" not in summarize({"a": A})
    both = pd.concat([table, summarize({"b": A})])
    assert to_display(both).loc["b", "success_without_contact"] == "–"


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


def test_compare_pairs_what_both_have_of_movable_objects_over_all_episodes() -> None:
    a, b = A.assign(effort=[1.0, 0.9, 0.8, 0.7], side_changes=0), B.assign(effort=0.8)
    table = compare(a, b)
    assert table.loc["effort", "count"] == 4  # of which both solved two
    assert table.loc["effort", "difference"] == pytest.approx(0.05)  # 0.85 - 0.8
    assert not {"side_changes", "path_share"} & set(table.index)


def test_other_episodes_are_not_compared() -> None:
    with pytest.raises(ValueError, match="'first' has 4 and 'second' 3"):
        compare(A, B.head(3))
    with pytest.raises(ValueError, match="that ran the same episodes"):
        summarize({"a": A, "b": B.assign(episode=[0, 1, 2, 4])})
    with pytest.raises(ValueError, match="at least one method, got none"):
        summarize({})
    with pytest.raises(ValueError, match="rows of 'a' must be of one episode or more"):
        summarize({"a": A.head(0)})


def test_a_table_in_markdown() -> None:
    head, rule, line = format_table(to_display(summarize({"a_1": A}))).splitlines()
    assert head.count("|") == rule.count("|") == line.count("|")
    assert line.startswith("| a_1 | 4 | 0.750 [0.250, 1.000] | 0.375 [0.125, 0.500] | 3 | 0.500 ± ")
    table = pd.DataFrame({"value": [np.nan, 0.5]}, index=["a|b", "c"])
    assert r"| a\|b | – |" in format_table(table)
    assert "| c | 0.500 |" in format_table(table)
