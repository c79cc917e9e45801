"""What a table of the evaluation sets says, by hand."""

import math
from dataclasses import replace

import pytest

from modpush.envs import Obstacle
from modpush.evaluation.authors_paths import authors_agent_length, authors_controller_length
from modpush.evaluation.set_statistics import set_statistics
from modpush.evaluation.sets import EvaluationSet
from modpush.evaluation.shortest import shortest_path
from tests.evaluation.test_authors_paths import PLAIN


def test_means_over_the_episodes_of_a_set() -> None:
    near = replace(PLAIN, object_pose=(0.475, 0.1, 0.0), goal_position=(0.475, -0.1))  # 0.2 m
    wall = Obstacle((0.2, 0.06, 0.06), (0.475, 0.0, 0.0))
    far = replace(
        PLAIN,
        obstacles=(wall,),
        object_pose=(0.475, 0.2, 0.0),
        goal_position=(0.475, -0.2),
    )
    scenarios = (PLAIN, near, far)
    found = set_statistics(EvaluationSet(name="own", scenarios=scenarios))
    lengths = [shortest_path(scenario)[1] for scenario in scenarios]
    agent = [authors_agent_length(scenario) for scenario in scenarios]
    controller = [authors_controller_length(scenario) for scenario in scenarios]
    assert found == {
        "episodes": 3,
        "distance": pytest.approx((math.hypot(0.2, 0.3) + 0.2 + 0.4) / 3),
        "under_0.3": pytest.approx(1 / 3),
        "straight": pytest.approx(2 / 3),  # round the wall the way bends
        "shortest_length": pytest.approx(sum(lengths) / 3),
        "authors_agent": pytest.approx(sum(a / b for a, b in zip(agent, lengths, strict=True)) / 3),
        "authors_controller": pytest.approx(
            sum(a / b for a, b in zip(controller, lengths, strict=True)) / 3
        ),
    }
    assert lengths[2] > 0.4
