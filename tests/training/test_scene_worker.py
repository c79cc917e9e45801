"""What a scene worker tells of its episodes, and how its scenes act, without a simulator."""

from types import SimpleNamespace
from typing import Any

import pytest
import torch
from tensordict import TensorDict
from torchrl.data import Bounded, Composite, Unbounded
from torchrl.envs import ExplorationType, set_exploration_type

from modpush.agents import TQCConfig, make_tqc_from_specs
from modpush.training.scene_worker import SceneWorker

FLAGS = (
    "done",
    "success",
    "out_of_bounds",
    "object_contact",
    "obstacle_contact",
    "tool_obstacle_contact",
)


def after(**columns: list[Any]) -> TensorDict:
    """What two scenes' step led to; flags that are not given are False."""
    values = {name: torch.tensor(value)[:, None] for name, value in columns.items()}
    return TensorDict({name: torch.zeros(2, 1, dtype=torch.bool) for name in FLAGS} | values, [2])


def test_each_scenes_sums_are_of_its_own_episode() -> None:
    worker: Any = SimpleNamespace(_sums=torch.zeros(2, 4), greedy_envs=[1])
    steps = [
        after(reward=[1.0, 2.0], object_contact=[True, False], obstacle_contact=[False, True]),
        after(
            reward=[0.5, -1.0],
            object_contact=[False, True],
            tool_obstacle_contact=[False, True],
            done=[False, True],
            success=[False, True],
        ),
        after(
            reward=[0.25, 4.0],
            object_contact=[True, True],
            tool_obstacle_contact=[True, False],
            done=[True, True],
            out_of_bounds=[True, False],
        ),
    ]
    ended = [SceneWorker._ended_episodes(worker, step, random=False) for step in steps]
    assert ended[0] == []
    # The second scene: rewards 2 - 1, contact in one of two steps, a collision in both.
    solved = {"success": 1, "out_of_bounds": 0, "steps": 2, "return": 1, "contact": 0.5}
    assert ended[1] == [{**solved, "collision": 1, "greedy": 1}]
    # The first scene: rewards 1 + 0.5 + 0.25; the second one's next episode began anew.
    lost = {"success": 0, "out_of_bounds": 1, "steps": 3, "return": 1.75, "greedy": 0}
    lost |= {"contact": pytest.approx(2 / 3), "collision": pytest.approx(1 / 3)}
    short = {"success": 0, "out_of_bounds": 0, "steps": 1, "return": 4, "contact": 1}
    assert ended[2] == [lost, {**short, "collision": 0, "greedy": 1}]
    # Where somebody else than the agent acts, no scene is greedy.
    assert SceneWorker._ended_episodes(worker, steps[2], random=True)[1]["greedy"] == 0


@pytest.mark.parametrize("loss", ["tqc", "td3"])
def test_greedy_scenes_act_without_noise_and_the_others_with_it(loss: str) -> None:
    torch.manual_seed(0)
    observed = Composite(observation=Unbounded((3,)))
    config = TQCConfig(hidden_sizes=(8,), loss=loss)
    agent = make_tqc_from_specs(config, observed, Bounded(-1, 1, (2,)))
    worker: Any = SimpleNamespace(
        explore=agent.exploration_policy, actor=agent.actor, greedy_envs=[2, 3]
    )
    td = TensorDict({"observation": torch.randn(4, 3)}, [4])
    with torch.no_grad():
        one, other = (SceneWorker._act(worker, td.clone())["action"] for _ in range(2))
        with set_exploration_type(ExplorationType.DETERMINISTIC):
            greedy = agent.actor(td.clone())["action"]
    for acted in (one, other):
        torch.testing.assert_close(acted[2:], greedy[2:])
    assert (one[:2] != other[:2]).all()
