import math
from collections import Counter
from dataclasses import replace
from functools import cache
from pathlib import Path

import cv2
import numpy as np
import pytest
from scipy.stats import kstest

from modpush.envs.scenes.conditions import EpisodeConditions
from modpush.envs.scenes.objects import get_object
from modpush.envs.scenes.obstacle import Obstacle
from modpush.envs.scenes.rectangles import obstacle_distance
from modpush.evaluation import sets
from modpush.evaluation.set_recipes import RECIPES
from modpush.evaluation.sets import (
    BEHIND_SETS,
    EVALUATION_SETS,
    SET_NAMES,
    TUNING_SETS,
    EvaluationSet,
    generate_set,
    load_set as read_set,
)
from modpush.evaluation.shortest import shortest_path
from modpush.files import write_packed_json
from modpush.training import TRAIN_PRESETS

ROOT = Path(__file__).parents[2]
load_set = cache(read_set)  # nothing changes a set, and most are read by six tests
COUNTS = {
    "smoke": 20,
    "free/small_cube": 500,
    "obstacles/small_cube": 1000,
    "obstacles/large_cube": 1000,
    "obstacles/small_cylinder": 1000,
    "obstacles/fragment": 1000,
    "hard/small_cube": 50,
    "hard200/small_cube": 200,
    "hard_wide/small_cube": 200,
    "pose/free/box": 200,
    "pose/one_rectangle/box": 500,
    "pose/one_circle/box": 500,
    "pose/one_cross/box": 500,
    "pose/one_t/box": 500,
    "pose/one_l/box": 500,
    "pose/two_rectangles/box": 500,
    "pose/moving_bar/box": 500,
    "pose/objects": 1008,
    "pose/unseen_objects": 1008,
    "moving/small_cube": 200,
    "tracks/4": 128,
    "tracks/8": 128,
    "tracks/12": 128,
    "hidden_dynamics": 1000,
    "hidden_dynamics_fine": 1000,
    "tuning/tracks/4": 64,
    "tuning/tracks/8": 64,
    "tuning/tracks/12": 64,
    "tuning/hidden_dynamics": 200,
    "tuning/small_cube": 200,
    "tuning/all_objects": 200,
    "tuning/pose/objects": 252,
    "tuning/hard": 100,
    "behind/free/small_cube": 500,
    "behind/obstacles/small_cube": 1000,
    "behind/obstacles/large_cube": 1000,
    "behind/obstacles/small_cylinder": 1000,
    "behind/obstacles/fragment": 1000,
    "behind/hard/small_cube": 50,
    "behind/hard200/small_cube": 200,
}
HIDDEN = tuple(name for name in SET_NAMES if "hidden_dynamics" in name)
OBJECTS_PAST_OBSTACLES = ("pose/objects", "pose/unseen_objects", "tuning/pose/objects")
SEVERAL_OBJECTS = ("smoke", "tuning/all_objects", *OBJECTS_PAST_OBSTACLES, *HIDDEN)
DIGESTS = {
    "tracks/4": "90e91f6b9ada",
    "tracks/8": "5e3c430781d0",
    "tracks/12": "bc6e5e8ad297",
    "hidden_dynamics": "18321f33ae8b",
    "hidden_dynamics_fine": "18321f33ae8b",
}


def test_there_are_the_sets_of_the_specification() -> None:
    assert COUNTS.keys() == set(SET_NAMES)


@pytest.mark.parametrize("name", SET_NAMES)
def test_a_set_has_its_episodes_in_equal_shares(name: str) -> None:
    loaded = load_set(name)
    assert len(loaded) == COUNTS[name]
    shares = Counter(s.scene for s in loaded).values()
    assert max(shares) - min(shares) <= 1
    if name not in SEVERAL_OBJECTS:
        small = "tuning" in name or "tracks" in name
        assert loaded.objects == ("small_cube" if small else name.split("/")[-1],)
    scenes = len({s.scene for s in loaded})
    assert set(Counter(s.scene for s in loaded.first(2 * scenes)).values()) == {2}


@pytest.mark.parametrize("name", SET_NAMES)
def test_the_generator_reproduces_a_part_exactly(name: str) -> None:
    loaded = load_set(name)
    numbers = range(0, len(loaded), max(1, len(loaded) // 25))
    again = generate_set(name, numbers)
    assert again.scenarios == tuple(loaded.scenarios[n] for n in numbers)


def test_saving_gives_the_same_bytes_again(tmp_path: Path) -> None:
    loaded = load_set("hard/small_cube")
    for k in range(2):
        loaded.save(tmp_path / f"{k}.json.gz")
    assert (tmp_path / "0.json.gz").read_bytes() == (tmp_path / "1.json.gz").read_bytes()
    assert read_set(tmp_path / "0.json.gz") == loaded


@pytest.mark.parametrize("name", [n for n in SET_NAMES if n != "smoke"])
def test_episodes_are_as_far_and_as_clear_as_specified(name: str) -> None:
    difficulties = []
    for s in load_set(name):
        ends = np.array([s.object_pose[:2], s.goal_position])
        assert 0.2 - 1e-5 <= np.linalg.norm(ends[1] - ends[0]) <= 0.6 + 1e-5
        radius = get_object(s.pushed_object).radius
        assert (obstacle_distance(ends, s.obstacles) >= radius + 0.06 - 1e-5).all()
        difficulties.append(s.difficulty)
    if len({*difficulties}) >= 500:  # uniform in [0, 1]: mean 1/2, sd 1/sqrt(12)
        assert np.mean(difficulties) == pytest.approx(0.5, abs=0.04)
        assert np.std(difficulties) == pytest.approx(12**-0.5, abs=0.03)


@pytest.mark.parametrize("name", [n for n in SET_NAMES if n != "smoke"])
def test_distances_are_uniform_in_a_set_and_in_its_families(name: str) -> None:
    loaded = load_set(name)
    distance = np.array([math.dist(s.object_pose[:2], s.goal_position) for s in loaded])
    scenes = np.array([s.scene for s in loaded])
    for chosen in (distance, *(distance[scenes == scene] for scene in {*scenes})):
        least = RECIPES[name].distance[0]
        assert kstest(chosen, "uniform", (least, 0.6 - least)).pvalue > 0.001


@pytest.mark.parametrize("name", [n for n in SET_NAMES if RECIPES[n].obstacle_between])
def test_an_obstacle_always_stands_between_object_and_goal(name: str) -> None:
    for s in load_set(name):
        ends = np.array([s.object_pose[:2], s.goal_position])
        way = ends[0] + np.linspace(0, 1, 601)[:, None] * (ends[1] - ends[0])
        assert obstacle_distance(way, s.obstacles).min() < 1e-3
    more = generate_set(name, [1999]).scenarios[0]  # than the set holds can be drawn
    assert more.scene == RECIPES[name].scenes[1999 % len(RECIPES[name].scenes)]


@pytest.mark.parametrize("name", OBJECTS_PAST_OBSTACLES)
def test_every_object_is_pushed_past_every_kind_of_obstacle_equally_often(name: str) -> None:
    loaded = load_set(name)
    pairs = Counter((s.scene, s.pushed_object) for s in loaded)
    assert len(pairs) == len({s for s, _ in pairs}) * len({o for _, o in pairs})
    assert len({*pairs.values()}) == 1
    trained = {*TRAIN_PRESETS["pose_obstacles"].env.scenario.pushed_object}
    if name == "pose/unseen_objects":
        assert trained.isdisjoint(loaded.objects)
    else:
        assert trained == {*loaded.objects}
    assert load_set("pose/one_t/box").conditions == loaded.conditions


def test_a_set_says_under_which_conditions_it_is_run(tmp_path: Path) -> None:
    hard = load_set("hard/small_cube")
    assert hard.conditions == EpisodeConditions(
        max_episode_steps=200, tool="2f85", sim_freq=120, inflation="inscribed"
    )
    assert load_set("hard_wide/small_cube").conditions.inflation == "circumscribed"
    other = EpisodeConditions(max_episode_steps=50, tool="rod", sim_freq=240)
    replace(hard, conditions=other).save(tmp_path / "set.json.gz")
    assert read_set(tmp_path / "set.json.gz").conditions == other
    assert hard.first(3).conditions == hard.conditions


def test_a_set_of_poses_says_so_and_holds_no_positions(tmp_path: Path) -> None:
    poses = load_set("pose/free/box")
    assert poses.conditions == EpisodeConditions(goal="pose", position_tolerance=0.015)
    poses.first(2).save(tmp_path / "set.json.gz")
    assert read_set(tmp_path / "set.json.gz") == poses.first(2)
    with pytest.raises(
        ValueError, match=r"scenarios\[0\] must have no goal_yaw with goal='position'"
    ):
        replace(poses, conditions=EpisodeConditions())
    with pytest.raises(ValueError, match=r"scenarios\[0\] must have a goal_yaw with goal='pose'"):
        replace(load_set("smoke"), conditions=poses.conditions)


def test_the_larger_hard_set_begins_with_the_paper_s_number_of_episodes() -> None:
    assert load_set("hard200/small_cube").scenarios[:50] == load_set("hard/small_cube").scenarios


def test_nothing_that_is_tuned_on_is_evaluated_on() -> None:
    assert {*EVALUATION_SETS, *BEHIND_SETS} <= set(SET_NAMES) - set(TUNING_SETS)
    evaluated = sorted(set(SET_NAMES) - {*TUNING_SETS, "smoke"})
    tuned = {(s.object_pose, s.goal_position) for name in TUNING_SETS for s in load_set(name)}
    assert len(tuned) == 500 + 3 * 64 + 8 * 5 + 252
    hard = set()
    for name in evaluated:
        episodes = load_set(name)
        assert not tuned & {(s.object_pose, s.goal_position) for s in episodes}
        hard |= {s.scene for s in episodes if "hard" in name}
    assert not hard & {s.scene for s in load_set("tuning/hard")}


@pytest.mark.parametrize("name", sorted(DIGESTS))
def test_a_benchmark_keeps_its_episodes(name: str) -> None:
    assert load_set(name).digest.startswith(DIGESTS[name])  # printed in docs/howto/benchmarks.md
    assert DIGESTS[name] in (ROOT / "docs" / "howto" / "benchmarks.md").read_text()


@pytest.mark.parametrize("count", [4, 8, 12])
def test_objects_of_a_track_stand_apart_and_often_leave_no_path(count: int) -> None:
    track, blocked = load_set(f"tracks/{count}"), 0
    assert track.conditions == EpisodeConditions(dynamic_obstacles=True)
    for s in track:
        assert len(s.obstacles) == count
        for k, one in enumerate(s.obstacles):
            assert obstacle_distance(_corners(one), s.obstacles[:k]).min(initial=1.0) > 0
        blocked += (free_way := shortest_path(s)[1]) == pytest.approx(
            math.dist(s.object_pose[:2], s.goal_position), abs=1e-9
        )
        assert free_way > 0
    # An object stands in the straight way, so that this is no path but what stands for none.
    assert {4: blocked == 0, 8: 50 < blocked < 90, 12: 70 < blocked < 110}[count]


def _corners(box: Obstacle) -> np.ndarray:
    (length, width, _), (x, y, yaw) = box.size, box.pose
    edge = np.linspace(-0.5, 0.5, 9)
    sides = [
        *((u, s) for u in edge for s in (-0.5, 0.5)),
        *((s, u) for u in edge for s in (-0.5, 0.5)),
    ]
    u, v = (np.array(sides) * (length, width)).T
    return np.stack(
        [x + u * math.cos(yaw) - v * math.sin(yaw), y + u * math.sin(yaw) + v * math.cos(yaw)], -1
    )


@pytest.mark.parametrize("name", HIDDEN)
def test_hidden_dynamics_meet_every_cell_and_in_200_episodes_every_pair_of_levels(name) -> None:
    loaded = load_set(name)
    assert loaded.hides_dynamics
    assert loaded.first(1).hides_dynamics
    assert loaded.conditions.yaw_tolerance == pytest.approx(math.radians(10))
    cells = [(s.pushed_object, s.dynamics) for s in loaded]
    assert len({*cells}) == len(cells)
    levels = [
        (s.pushed_object, s.dynamics.mass, s.dynamics.friction, s.dynamics.center_of_mass)
        for s in loaded
    ]
    for first in range(0, len(levels), 200):
        block = levels[first : first + 200]
        for a, b in ((1, 2), (1, 3), (2, 3)):
            assert len({(row[0], row[a], row[b]) for row in block}) == 200
    starts = Counter((s.pushed_object, s.object_pose, s.goal_position, s.tool_pose) for s in loaded)
    assert len(starts) == 40
    assert set(starts.values()) == {len(loaded) // 40}
    for field in ("mass", "friction", "center_of_mass"):
        pairs = Counter((s.object_pose, getattr(s.dynamics, field)) for s in loaded)
        assert set(pairs.values()) == {len(loaded) // 200}


def test_a_shifted_centre_of_mass_is_over_the_object() -> None:
    for s in load_set("hidden_dynamics"):
        corners = np.concatenate(get_object(s.pushed_object).footprints()).astype(np.float32)
        inside = cv2.pointPolygonTest(cv2.convexHull(corners), s.dynamics.center_of_mass, True)
        assert inside > 0.004  # [m]


@pytest.mark.parametrize("name", BEHIND_SETS)
def test_the_tool_starts_straight_behind_the_object_in_the_base_set_s_episodes(name: str) -> None:
    behind, base = load_set(name), load_set(name.removeprefix("behind/"))
    kept = 0
    for episode, other in zip(behind, base, strict=True):
        assert episode.obstacles == other.obstacles
        start, goal, tool = (
            np.array(p[:2]) for p in (episode.object_pose, episode.goal_position, episode.tool_pose)
        )
        distance = math.dist(start, goal)
        assert distance == pytest.approx(
            math.dist(other.object_pose[:2], other.goal_position), abs=3e-6
        )
        np.testing.assert_allclose(tool, start - 0.09 * (goal - start) / distance, atol=1e-5)
        across = (math.cos(episode.tool_pose[2]), math.sin(episode.tool_pose[2]))
        assert np.dot(across, (goal - start) / distance) == pytest.approx(0, abs=1e-5)
        assert obstacle_distance(tool, episode.obstacles) > math.hypot(0.032, 0.011) + 0.0049
        kept += (episode.object_pose, episode.goal_position) == (
            other.object_pose,
            other.goal_position,
        )
    assert kept >= 0.9 * len(base)
    assert behind.with_conditions(tool="rod").scenarios == behind.scenarios


def test_the_files_are_small() -> None:
    folder = Path(sets.__file__).parent / "data"
    assert sum(path.stat().st_size for path in folder.rglob("*.gz")) < 3e6


def test_an_unknown_set_is_answered_with_the_list() -> None:
    with pytest.raises(ValueError, match=r"no set 'free/cube', expected one of \['smoke', 'free"):
        load_set("free/cube")
    with pytest.raises(ValueError, match=r"name must be one of \['smoke', .*, got 'x'"):
        generate_set("x")


def test_a_truncated_file_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "set.json.gz"
    load_set("smoke").save(path)
    path.write_bytes(path.read_bytes()[:-200])
    with pytest.raises(ValueError, match=r"set.json.gz"):
        read_set(path)
    path.write_bytes(b"{}")
    with pytest.raises(ValueError, match=r"set.json.gz"):
        read_set(path)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ([], "must hold a name, conditions and episodes"),
        ({"name": "mine", "episodes": []}, "must hold a name, conditions and episodes"),
        (
            {"name": "mine", "conditions": {}, "episodes": [{"scene": "free"}]},
            "Scenario: difficulty: Field required",
        ),
        (
            {"name": "mine", "conditions": {"tool": "spoon"}, "episodes": []},
            "EpisodeConditions: tool must be one of .*got 'spoon'",
        ),
        (
            {"name": "../mine", "conditions": {}, "episodes": []},
            r"EvaluationSet: name must be .*got '../mine'",
        ),
    ],
)
def test_another_file_is_refused(tmp_path: Path, content: object, message: str) -> None:
    path = tmp_path / "set.json.gz"
    write_packed_json(path, content)
    with pytest.raises(ValueError, match=message):
        read_set(path)


@pytest.mark.parametrize("name", ["..", "a/../b", "/tmp/x", "", "a//b", "a\\b", ".hidden", "a/"])
def test_a_name_that_leads_out_of_a_results_folder_is_refused(name: str) -> None:
    with pytest.raises(ValueError, match="EvaluationSet: name must be letters, digits"):
        EvaluationSet(name=name, scenarios=())


def test_first_takes_the_first_episodes() -> None:
    smoke = load_set("smoke")
    assert smoke.first(3).scenarios == smoke.scenarios[:3]
    assert smoke.first(None) == smoke == smoke.first(100)
    assert isinstance(smoke.first(1), EvaluationSet)
    with pytest.raises(ValueError, match=r"count: .*greater than or equal to 1, got 0"):
        smoke.first(0)


def test_a_set_with_another_tool_has_its_episodes_and_another_name() -> None:
    hard = load_set("hard/small_cube").first(3)
    with_rod = hard.with_conditions(tool="rod")
    assert with_rod.name == "hard/small_cube+rod"
    assert with_rod.scenarios == hard.scenarios
    assert with_rod.digest == hard.digest
    assert with_rod.conditions == replace(hard.conditions, tool="rod")
    assert hard.with_conditions(tool="2f85") is hard
    with pytest.raises(ValueError, match=r"tool.*'2f85'.*'spoon'"):
        hard.with_conditions(tool="spoon")  # type: ignore[arg-type]
