"""PoseSubgoals as a TorchRL transform: on an environment, on stored data, without a path."""

import math

import pytest
import torch
from tensordict import TensorDict, TensorDictBase
from torchrl.data import LazyTensorStorage, ReplayBuffer, Unbounded
from torchrl.envs import Compose, TransformedEnv, check_env_specs

from modpush.geometry import Camera
from modpush.planners import OccupancyGrid, PoseField, PoseSubgoals, polygon_support, poses_along
from tests.planners.table_scene import TableEnv

SMALL = Camera(height=64, width=64)
BOX = polygon_support(
    torch.tensor([[1, 1], [1, -1], [-1, 1], [-1, -1]]) * torch.tensor([0.05, 0.025])
)
WRITTEN = ["pose_path_length", "subgoal_pose", "pose_path_found", "pose_path_ahead"]


class PoseTable(TableEnv):
    """The table with a goal pose and an oblong object."""

    def __init__(self, num_envs: int | None = None) -> None:
        super().__init__(num_envs)
        for key, size in (("goal_pose", 3), ("object_support", 48), ("object_symmetry", 1)):
            spec = Unbounded(shape=(*self.batch_size, size), dtype=torch.float32)
            self.observation_spec[key] = spec

    def _observe(self):
        observed = super()._observe()
        goal = observed["goal_position"]
        lead = goal.shape[:-1]
        yaw = torch.full((*lead, 1), 0.4)
        return {
            **observed,
            "goal_pose": torch.cat([goal, yaw], -1),
            "object_support": BOX.expand(*lead, 48).clone(),
            "object_symmetry": torch.full((*lead, 1), 2.0),
        }


def make_env(num_envs=None, **kwargs):
    planner = PoseSubgoals(PoseField(SMALL), ahead=(0.05, 0.3), **kwargs)
    return TransformedEnv(PoseTable(num_envs), Compose(OccupancyGrid(camera=SMALL), planner))


def ahead(tensordict: TensorDictBase) -> TensorDictBase:
    action = torch.tensor([0.3, 1.0]).expand(*tensordict.batch_size, 2)
    return tensordict.set("action", action.clone())


def check_row_by_row(rollout: TensorDictBase) -> None:
    """Each step's outputs are what the planner says of that step's inputs alone."""
    flat = rollout.reshape(-1)
    names = ("blocked_bits", "object_support", "object_pose", "goal_pose")
    paths = PoseField(SMALL).plan(*(flat[name] for name in names), flat["object_symmetry"][:, 0])
    assert paths.found.all()
    assert torch.equal(flat["pose_path_length"][:, 0], paths.length)
    subgoal = poses_along(paths, 0.2 * paths.length[:, None])[:, 0]
    torch.testing.assert_close(flat["subgoal_pose"], subgoal)
    torch.testing.assert_close(flat["pose_path_ahead"], poses_along(paths, [0.05, 0.3]))


@pytest.mark.parametrize("num_envs", [None, 3])
def test_specs_hold(num_envs):
    check_env_specs(make_env(num_envs))


def test_stored_data_are_planned_again():
    rollout = make_env(2).rollout(6, ahead, break_when_any_done=False).reshape(-1)
    buffer = ReplayBuffer(storage=LazyTensorStorage(12), batch_size=12)
    buffer.extend(rollout)
    buffer.append_transform(PoseSubgoals(PoseField(SMALL), ahead=(0.05, 0.3)))
    check_row_by_row(buffer.sample())
    check_row_by_row(buffer.sample()["next"])


def test_without_a_path_the_last_one_is_kept():
    transform = PoseSubgoals(PoseField(SMALL), ahead=(0.1,), path_found_key=("path", "found"))
    free = TensorDict(PoseTable(2)._observe() | {"blocked_bits": torch.zeros(2, 64, 8).byte()}, [2])
    free["object_pose"] = torch.tensor([[0.4, 0.1, 0.3 + math.pi]] * 2)
    free["goal_pose"] = torch.tensor([[0.7, 0.1, 0.1]] * 2)
    walled = free.clone()
    walled["blocked_bits"][:, 32] = 255
    first = transform._reset(free.empty(), walled.clone())
    assert not first["path", "found"].any()
    # 0.3 m on, and 0.2 rad modulo pi at a radius of 5.59 cm
    expected = torch.full((2, 1), 0.3 + 0.2 * 0.0559)
    torch.testing.assert_close(first["pose_path_length"], expected, atol=1e-4, rtol=0)
    assert torch.equal(first["subgoal_pose"], free["goal_pose"])
    assert torch.equal(first["pose_path_ahead"], free["goal_pose"][:, None])
    before = transform._reset(free.empty(), free.clone())
    assert before["path", "found"].all()
    # The yaw is continuous from the object's.
    yaw = torch.full((2,), 0.3 + math.pi - 0.04)
    torch.testing.assert_close(before["subgoal_pose"][:, 2], yaw, atol=1e-5, rtol=0)
    after = transform._step(before, walled.clone())
    assert not after["path", "found"].any()
    for key in ("pose_path_length", "subgoal_pose", "pose_path_ahead"):
        assert torch.equal(after[key], before[key])


def test_the_full_circle_takes_the_goal_s_yaw_as_it_is():
    data = make_env(1).reset().exclude(*WRITTEN)
    data["object_pose"][:, 2] = 0.4 + math.pi
    half = PoseSubgoals(PoseField(SMALL))(data.clone())["pose_path_length"]
    full = PoseSubgoals(PoseField(SMALL), symmetry_key=None)(data)["pose_path_length"]
    assert full.item() > half.item() + 0.1
