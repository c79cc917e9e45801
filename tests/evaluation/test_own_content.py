"""An object and a scene of one's own, from sampling to pictures."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from torchrl.envs import TransformedEnv

from modpush.agents import ScriptedPusher
from modpush.envs import Obstacle, PushedObject, PushEnv, ScenarioConfig, sample_scenario
from modpush.envs.scenes.conditions import EpisodeConditions
from modpush.envs.scenes.drawing import draw_top_view, to_pixels
from modpush.envs.scenes.layouts import get_scene
from modpush.evaluation import EvaluationConfig, EvaluationSet, evaluate
from modpush.evaluation.episodes import run_episodes
from modpush.evaluation.report import draw_episode, draw_frames, draw_results
from modpush.evaluation.shortest import shortest_path
from modpush.geometry import Label, box, centered
from modpush.planners import OccupancyGrid

L_SHAPE = PushedObject(
    name="l_shape",
    parts=centered(box(0.10, 0.03, 0.04), box(0.03, 0.07, 0.04, (0.035, 0.05, 0.0))),
    mass=0.8,
)
BLUE = (40, 90, 200)


def two_walls(rng: np.random.Generator, difficulty: float) -> list[Obstacle]:
    return [Obstacle((0.2, 0.06, 0.06), (0.45, y, 0.0)) for y in (-0.3, 0.3)]


def make_env(num_envs: int, objects) -> PushEnv:
    return PushEnv(num_envs, pushed_object=list(objects), max_episode_steps=3)


def drawn(pushed_object, count: int = 3):
    config = ScenarioConfig(scene=two_walls, pushed_object=pushed_object)
    return [sample_scenario(np.random.default_rng(seed), config) for seed in range(count)]


@pytest.mark.parametrize("by_text", [False, True])
def test_from_sampling_to_pictures(by_text: bool) -> None:
    given = f"{__name__}:L_SHAPE" if by_text else L_SHAPE
    scenarios = drawn(given)
    assert {s.pushed_object for s in scenarios} == {given if by_text else "l_shape"}
    assert get_scene(scenarios[0].scene)[1] is two_walls
    env = PushEnv(2, scene=two_walls, pushed_object=given, max_episode_steps=3, seed=0)
    td = env.reset(scenarios=scenarios[:2])
    torch.testing.assert_close(td["object_radius"], torch.full((2, 1), L_SHAPE.radius))
    assert td["object_symmetry"].tolist() == [[1.0], [1.0]]
    # 51 cm^2 at a height of 4 cm, where a pixel is 3.43 mm wide: 433 pixels, and some of the sides.
    for seen in (td["segmentation"] == Label.OBJECT).flatten(1).sum(1).tolist():
        assert 420 < seen < 560
    stacked = TransformedEnv(env, OccupancyGrid(object_radius_key="object_radius"))
    objects = env.pushed_objects
    episodes = list(run_episodes(stacked, ScriptedPusher(), enumerate(scenarios)))
    env.close()
    assert sorted(episode.number for episode in episodes) == [0, 1, 2]
    for episode in episodes:
        corners, _ = shortest_path(episode.scenario, objects=objects)
        np.testing.assert_allclose(episode.trajectory.planned_path, corners, atol=1e-6)
        picture = draw_episode(episode.scenario, episode.trajectory, objects=objects)
        assert_an_l_is_drawn(picture, episode.trajectory.object_pose[-1])
        frames = draw_frames(episode.scenario, episode.trajectory, objects=objects)
        np.testing.assert_array_equal(list(frames)[-1], picture)


def assert_an_l_is_drawn(picture: np.ndarray, pose: np.ndarray) -> None:
    """The object's colour is in both legs of the L and not in its notch."""
    x, y, yaw = pose.tolist()
    turn = np.array([[np.cos(yaw), np.sin(yaw)], [-np.sin(yaw), np.cos(yaw)]])

    def colours_around(point) -> set[tuple[int, ...]]:
        u, v = to_pixels(np.array(point) @ turn + [x, y]) // 16
        return {tuple(c) for c in picture[v - 3 : v + 4, u - 3 : u + 4].reshape(-1, 3).tolist()}

    first, second = (outline.mean(0) for outline in L_SHAPE.footprints())
    assert BLUE in colours_around(first)
    assert BLUE in colours_around(second)
    assert BLUE not in colours_around([first[0] - 0.02, second[1]])


def test_an_object_given_by_text_is_evaluated_and_drawn_without_saying_more(tmp_path) -> None:
    chosen = EvaluationSet(
        name="mine",
        scenarios=tuple(drawn(f"{__name__}:L_SHAPE")),
        conditions=EpisodeConditions(max_episode_steps=3),
    )
    rows = evaluate(
        ScriptedPusher(),
        chosen,
        tmp_path / "results",
        make_env=make_env,
        config=EvaluationConfig(num_envs=2, progress=False),
    )
    assert len(rows) == 3
    s = chosen.scenarios[0]
    assert_an_l_is_drawn(draw_top_view(s, s.object_pose, (9, 9, 0)), np.array(s.object_pose))


def test_results_with_an_object_of_your_own_are_drawn(tmp_path) -> None:
    mine = EvaluationSet(name="mine", scenarios=drawn(L_SHAPE, 2))

    def make(num_envs: int, objects) -> PushEnv:
        return PushEnv(num_envs, pushed_object=L_SHAPE, max_episode_steps=3)

    conditions = EpisodeConditions(max_episode_steps=3)
    mine = replace(mine, conditions=conditions)
    rows = evaluate(
        ScriptedPusher(),
        mine,
        tmp_path,
        make_env=make,
        config=EvaluationConfig(num_envs=2, progress=False),
    )
    draw_results(rows, mine, tmp_path, "scripted", videos=False, objects={"l_shape": L_SHAPE})
    assert (tmp_path / "failures.png").stat().st_size > 1000
