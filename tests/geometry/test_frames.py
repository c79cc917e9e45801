import math

import pytest
import torch

from modpush.geometry import frame_yaw


def test_yaw_of_each_frame_by_hand():
    pose, subgoal = torch.tensor([[0.4, 0.1, 0.3]]), torch.tensor([[0.4, 0.3]])
    assert frame_yaw("base", pose).item() == 0.0
    assert frame_yaw("object", pose).item() == pytest.approx(0.3)
    assert frame_yaw("path", pose, subgoal).item() == pytest.approx(math.pi / 2)  # +y of the object


def test_the_path_at_its_end_has_the_base_s_axes():
    pose = torch.tensor([[0.4, 0.1, 0.3]])
    assert frame_yaw("path", pose, pose[:, :2]).item() == 0.0


def test_the_path_needs_a_subgoal():
    with pytest.raises(ValueError, match="needs a sub-goal"):
        frame_yaw("path", torch.zeros(1, 3))
