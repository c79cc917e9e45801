"""The agent's action, turned into the robot's base frame."""

import math

import pytest
import torch
from tensordict import TensorDict
from torchrl.data import LazyTensorStorage, ReplayBuffer
from torchrl.envs import Compose, InitTracker, Transform, TransformedEnv, check_env_specs

from modpush.envs import PushEnv
from modpush.geometry.frames import rotate
from modpush.mdp.action_frame import ActionFrame


def acted(frame, action, yaw=0.0, subgoal=(1.0, 0.0)):
    td = TensorDict(
        {
            "action": torch.tensor([action]),
            "object_pose": torch.tensor([[0.0, 0.0, yaw]]),
            "subgoal": torch.tensor([subgoal]),
        },
        [1],
    )
    return ActionFrame(frame).inv(td)["action"][0]


def test_forward_in_the_path_frame_is_towards_the_subgoal():
    torch.testing.assert_close(
        acted("path", [1.0, 0.0, 0.2], subgoal=(0.0, -1.0)),
        torch.tensor([0.0, -1.0, 0.2]),
        atol=1e-6,
        rtol=0,
    )


def test_forward_in_the_object_frame_turns_with_it():
    torch.testing.assert_close(
        acted("object", [0.5, 0.0, -1.0], yaw=math.pi), torch.tensor([-0.5, 0.0, -1.0])
    )


def test_a_corner_of_the_box_keeps_its_direction_and_stays_inside():
    turned = acted("object", [1.0, 1.0, 0.0], yaw=math.pi / 4)  # (0, sqrt 2) before it is shrunk
    torch.testing.assert_close(turned, torch.tensor([0.0, 1.0, 0.0]), atol=1e-6, rtol=0)


@pytest.mark.parametrize("frame", ["base", "object", "path"])
def test_an_action_in_the_base_frame_is_the_agents_action_that_is_turned_into_it(frame):
    torch.manual_seed(0)
    action = torch.cat(
        [
            rotate(torch.rand(50, 1) * torch.tensor([1.0, 0.0]), torch.rand(50, 1) * 7),
            torch.rand(50, 1),
        ],
        -1,
    )
    td = TensorDict(
        {"action": action, "object_pose": torch.randn(50, 3), "subgoal": torch.randn(50, 2)}, [50]
    )
    transform = ActionFrame(frame)
    turned = transform.to_agent(td.clone())
    assert turned["action"].abs().max() <= 1.0
    torch.testing.assert_close(transform.inv(turned)["action"], action, atol=1e-5, rtol=1e-5)


def test_nested_keys():
    group = {
        "action": torch.tensor([[1.0, 0.0, 0.2]]),
        "pose": torch.zeros(1, 3),
        "subgoal": torch.tensor([[0.0, -1.0]]),
    }
    td = TensorDict({"arm": TensorDict(group, [1])}, [1])
    turn = ActionFrame(
        "path",
        action_key=("arm", "action"),
        object_pose_key=("arm", "pose"),
        subgoal_key=("arm", "subgoal"),
    )
    expected = torch.tensor([[0.0, -1.0, 0.2]])
    torch.testing.assert_close(turn.inv(td)["arm", "action"], expected, atol=1e-6, rtol=0)
    assert torch.equal(td["arm", "action"], group["action"])


def test_on_an_environment_the_tool_moves_along_the_objects_axis():
    env = TransformedEnv(PushEnv(2, depth=None, seed=3), ActionFrame("object"))
    check_env_specs(env)
    td = env.reset()
    before, yaw = td["ee_pose"][:, :2].clone(), td["object_pose"][:, 2:].clone()
    action = torch.tensor([[1.0, 0.0, 0.0]]).expand(2, 3).clone()
    after = env.step(td.set("action", action))["next", "ee_pose"][:, :2]
    moved = rotate(after - before, -yaw)
    assert (moved[:, 0] > 0.01).all()  # of 20 mm at most, and the first step lags
    assert (moved[:, 1].abs() < 0.15 * moved[:, 0]).all()
    # What the agent chose is what is stored, not what the robot was told.
    assert torch.equal(td["action"], action)
    env.close()


class ActionTwice(Transform):
    """Writes twice the action that transforms behind `ActionFrame` read."""

    def _step(self, tensordict, next_tensordict):
        return next_tensordict.set("twice", 2 * tensordict["action"])


def test_transforms_behind_it_read_the_agents_action():
    env = TransformedEnv(
        PushEnv(2, depth=None, seed=3), Compose(ActionFrame("object"), ActionTwice())
    )
    action = torch.tensor([[1.0, 0.5, -0.2]] * 2)
    td = env.step(env.reset().set("action", action))
    assert torch.equal(td["next", "twice"], 2 * action)
    env.close()


@pytest.mark.parametrize("pack", [lambda t: t, lambda t: Compose(InitTracker(), t)])
def test_in_a_replay_buffer_it_is_refused(pack):
    buffer = ReplayBuffer(storage=LazyTensorStorage(4), transform=pack(ActionFrame("object")))
    steps = TensorDict(
        {"action": torch.ones(2, 3), "object_pose": torch.zeros(2, 3)}, batch_size=[2]
    )
    with pytest.raises(RuntimeError, match="ActionFrame: it belongs to an environment"):
        buffer.extend(steps)
