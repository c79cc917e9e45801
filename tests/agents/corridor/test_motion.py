"""Motions of the tool by hand."""

import math

import numpy as np
import pytest
import torch

from modpush.agents import CorridorConfig, faithful_config
from modpush.agents.corridor.learning import Stance
from modpush.agents.corridor.motion import next_tool_position, push_velocity, turn_wide_side
from modpush.geometry import Camera
from modpush.planners import LazyThetaStar
from tests.agents.corridor.corridor_scenes import scene


def motion(push, relocate, near, has_moved, alpha=0.3, alpha_p=0.0, config=None):
    config = config or CorridorConfig(inversion=0.6)
    now = scene([None], Camera(), (0.4, 0.0), (0.3, 0.0), radius=0.08 if near else 0.02)
    numbers = (torch.tensor([value]) for value in (alpha, alpha_p, push, relocate))
    moved = torch.tensor([has_moved])
    return push_velocity(now, Stance(*numbers), moved, config)[0].tolist()


def test_moves_by_hand():
    # The tool is behind the object on x; alpha_p - alpha < 0 turns "aside" to +y.
    assert motion(0.9, 0.4, True, True) == pytest.approx([0.9, 0.4])  # pushes
    assert motion(0.9, 0.4, True, True, alpha=-0.3) == pytest.approx([0.9, -0.4])
    assert motion(0.6, 0.8, True, True) == pytest.approx([-0.08, 0.8])  # inverts
    assert motion(0.6, 0.8, False, False) == pytest.approx([1.0, 0.8])  # first approach
    assert motion(0.6, 0.8, False, True) == pytest.approx([0.6, 0.8])  # comes back
    assert motion(0.8, 0.6, True, True) == pytest.approx([-0.06, 0.6])  # from 0.6 on ...
    faithful = motion(0.8, 0.6, True, True, config=faithful_config())
    assert faithful == pytest.approx([0.8, 0.6])  # ... beyond it in the authors' code


def test_the_wide_side_turns_towards_the_push_the_shorter_way():
    # At yaw 0 the wide side lies along x and faces a push along y; half a turn makes no difference.
    push = torch.tensor([math.pi / 2, math.pi / 2, 0.0, 0.0])
    yaw = torch.tensor([0.0, math.pi, math.pi / 2 - 0.02, -math.pi / 2 + 0.02])
    turn = turn_wide_side(push, yaw, 0.05)
    assert turn.tolist() == pytest.approx([0.0, 0.0, 0.4, -0.4], abs=1e-5)
    clipped = turn_wide_side(torch.zeros(1), torch.ones(1), 0.05)
    assert clipped.item() == pytest.approx(1.0)


def test_the_path_of_the_tool_leads_around_the_object():
    camera = Camera(height=40, width=60)
    size, none = camera.cell_size, np.full((40, 60), np.inf, np.float32)
    position = camera.unproject(torch.tensor([[30.0, 20.0]]))
    target = camera.unproject(torch.tensor([[50.0, 20.0]]))
    tool = camera.unproject(torch.tensor([[45.0, 20.0]]))  # on the wrong side
    config = CorridorConfig(near_distance=8 * size, tool_clearance=0.0)
    trail = []
    for _ in range(40):
        now = scene([none], camera, position, tool)
        ahead = next_tool_position(now, target, config, LazyThetaStar())
        step = ahead - tool
        tool = tool + step * (1.5 * size / step.norm().clamp_min(1.5 * size))
        trail.append(camera.project(tool)[0])
    away = (torch.stack(trail) - torch.tensor([30.0, 20.0])).norm(dim=-1)
    assert away.min() > 6.5
    assert trail[-1][0] < 30 - 6
    assert abs(trail[-1][1] - 20) < 3
