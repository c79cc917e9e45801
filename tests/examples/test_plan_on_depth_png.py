"""The example plans on its own picture and on one that is given."""

import math

import cv2
import numpy as np
import pytest

from tests.examples import load_example


@pytest.fixture(scope="module")
def example():
    return load_example("plan_on_depth_png")


def test_plans_on_a_picture_of_its_own(example, tmp_path, capsys):
    output = tmp_path / "new" / "plan.png"
    length = example.main(example.Config(output=output))
    straight = math.hypot(130, 160) * 0.0035596
    assert straight * 1.05 < length < straight * 1.6
    assert cv2.imread(str(output)).shape == (768, 768, 3)
    assert "corners" in capsys.readouterr().out


def test_plans_on_a_picture_that_is_given(example, tmp_path):
    path = tmp_path / "empty.png"
    cv2.imwrite(str(path), np.full((100, 120), 900, np.uint16))
    config = example.Config(
        depth=path, start=(10, 10), goal=(50, 40), camera_height=0.9, output=tmp_path / "out.png"
    )
    # 50 px of 0.9 m * 2 tan(22.5 deg) / 100 = 7.456 mm each.
    assert example.main(config) == pytest.approx(0.3728, abs=1e-3)


def test_a_picture_of_another_kind_is_refused(example, tmp_path):
    path = tmp_path / "colour.png"
    cv2.imwrite(str(path), np.zeros((8, 8, 3), np.uint8))
    with pytest.raises(ValueError, match="is not a 16-bit picture of one channel"):
        example.main(example.Config(depth=path))
