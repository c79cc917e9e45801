"""The picture of a run's evaluations."""

import pandas as pd
import pytest

from modpush.training.log import draw_curve


def test_curve_is_drawn(tmp_path):
    rows = [
        {"minutes": n, "success": n / 4, "contact_rate": 0.5, "collision_rate_object": 0.0}
        for n in range(4)
    ]
    pd.DataFrame(rows).to_csv(tmp_path / "evaluations.csv", index=False)
    draw_curve(tmp_path / "evaluations.csv", tmp_path / "pictures" / "curve.png")
    head = (tmp_path / "pictures" / "curve.png").read_bytes()[:8]
    assert head == b"\x89PNG\r\n\x1a\n"
    with pytest.raises(FileNotFoundError):
        draw_curve(tmp_path / "none.csv", tmp_path / "no.png")
