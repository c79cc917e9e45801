"""Learning curves of runs that were evaluated on different scene families."""

import pandas as pd
import pytest

from modpush.training.curve import draw_curve, success_in_common

SHARED = {"contact_rate": 0.5, "collision_rate_object": 0.0, "updates": 3, "minutes": 1.0}


@pytest.fixture
def tables():
    wide = {"success": 0.6, "success/free": 1.0, "success/slot": 0.5, "success/posts": 0.3}
    narrow = {"success": 0.45, "success/posts": 0.2, "success/slot": 0.7}
    return [pd.DataFrame([{"step": 10, **row, **SHARED}]) for row in (wide, narrow)]


def test_success_is_compared_over_the_families_in_common(tables):
    assert success_in_common(tables) == ["posts", "slot"]
    assert tables[0]["success"].item() == pytest.approx(0.4)  # (0.5 + 0.3) / 2
    assert tables[1]["success"].item() == 0.45  # as it was


def test_a_row_of_panels_for_each_axis(tables, tmp_path):
    for name, table in zip("ab", tables, strict=True):
        (tmp_path / name).mkdir()
        table.to_csv(tmp_path / name / "evaluations.csv", index=False)
    runs = [tmp_path / "a", tmp_path / "b"]
    draw_curve(runs, tmp_path / "one.png", against="step")
    draw_curve(runs, tmp_path / "three.png", against=("step", "updates", "minutes"))
    one, three = ((tmp_path / name).read_bytes()[16:24] for name in ("one.png", "three.png"))
    height = [int.from_bytes(size[4:], "big") for size in (one, three)]
    assert height[1] == pytest.approx(3 * height[0], abs=2)
    with pytest.raises(FileNotFoundError):
        draw_curve([tmp_path / "none"], tmp_path / "no.png")
