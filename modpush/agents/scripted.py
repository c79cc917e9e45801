"""A scripted pusher: it moves behind the object, pushes it to the target and corrects the direction."""

import math

import torch
from tensordict import NestedKey, TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor

from modpush._checks import check_dtype, check_finite, read_key
from modpush._validation import checked_arguments
from modpush.geometry.frames import direction_of, wrap_angle

# Tuned by hand in free space.
_TOOL_RADIUS = 0.034  # circumscribed, of the tool's tip [m]
_MARGIN = 0.012  # between tool and object while the tool goes around it [m]
# Largest angles from the line through target and object [rad]
_APPROACH_ANGLE = 0.15  # at which the tool approaches the object
_PUSH_ANGLE = 0.7  # at which a tool in contact continues to push
_CIRCLE_WIDTH = 0.02  # distance from the circle at which the tool turns towards it by 1 rad [m]
_MAX_INWARDS = 1.2  # largest such turn [rad]
_STEER_GAIN = 1.5  # correction of the pushing direction, as a multiple of the angle from the line
_PUSH_SPEED = 0.7  # length of a step while in contact, as a fraction of the largest step
_MAX_TURN = 0.05  # `MotionConfig.max_turn`, of a package that agents do not import [rad]


def scripted_push(
    object_position: Tensor,
    target: Tensor,
    ee_pose: Tensor,
    contact: Tensor,
    object_radius: Tensor,
) -> Tensor:
    """Actions of the scripted pusher, `[B, 3]` in [-1, 1].

    The object's position and target are `[B, 2]` [m], the pose of the tool's tip `[B, 3]` [m, m, rad],
    their contact `[B, 1]` bool, and the object's circumscribed radius `[B, 1]` [m].
    """
    to_object = object_position - ee_pose[:, :2]
    to_target = target - object_position
    distance = torch.linalg.vector_norm(to_object, dim=-1)
    bearing, heading = direction_of(to_object), direction_of(to_target)
    off = wrap_angle(bearing - heading)  # 0: the tool is right behind the object
    behind = off.abs() < torch.where(contact[:, 0], _PUSH_ANGLE, _APPROACH_ANGLE)

    push = _towards(heading + (1 + _STEER_GAIN) * off)
    push = push * torch.where(contact[:, 0], _PUSH_SPEED, 1.0).to(push)[:, None]

    # Around the object on a circle, the shorter way; far from the circle, towards it.
    circle = object_radius[:, 0] + _TOOL_RADIUS + _MARGIN
    side = torch.where(off > 0, 1.0, -1.0).to(off)
    inwards = ((distance - circle) / _CIRCLE_WIDTH).clamp(-_MAX_INWARDS, _MAX_INWARDS)
    around = _towards(bearing + side * (math.pi / 2 - inwards))

    move = torch.where(behind[:, None], push, around)
    # The wide side of the gripper faces the pushing direction; half a turn makes no difference.
    turn = wrap_angle(2 * (heading + math.pi / 2 - ee_pose[:, 2])) / 2
    action = torch.cat([move, (turn / _MAX_TURN)[:, None]], -1)
    return action.clamp(-1.0, 1.0)


def _towards(angle: Tensor) -> Tensor:
    """Vectors of length 1, `[..., 2]`."""
    return torch.stack([torch.cos(angle), torch.sin(angle)], -1)


class ScriptedPusher(TensorDictModuleBase):
    """The scripted pusher as a policy without state.

    It ignores obstacles and pushes straight towards its target. Give it a planner's sub-goals
    (`target_key="subgoal"`) to push along a path.

    Args:
        target_key: Key of the object's target position, `[B, 2]` [m], base frame.
        object_pose_key: Key of the object's pose, `[B, 3]` [m, m, rad], base frame.
        ee_pose_key: Key of the pose of the tool's tip, `[B, 3]` [m, m, rad], base frame.
        contact_key: Key of the contact between tool and object, `[B, 1]` bool.
        object_radius_key: Key of the object's circumscribed radius, `[B, 1]` [m].
        action_key: Key of the action, written, `[B, 3]` in the base frame, for `PushEnv` and for
            `make_push_env(action_frame="base")`; the preset `cpu` acts in the path's frame.
            `get_method("scripted")` has a suitable environment.
    """

    @checked_arguments
    def __init__(
        self,
        *,
        target_key: NestedKey = "goal_position",
        object_pose_key: NestedKey = "object_pose",
        ee_pose_key: NestedKey = "ee_pose",
        contact_key: NestedKey = "object_contact",
        object_radius_key: NestedKey = "object_radius",
        action_key: NestedKey = "action",
    ) -> None:
        super().__init__()
        self.in_keys = [object_pose_key, target_key, ee_pose_key, contact_key, object_radius_key]
        self.out_keys = [action_key]

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Write the action.

        Raises:
            KeyError: If a key is missing; the message lists the keys.
            TypeError: If a value is not a tensor of real numbers.
            ValueError: If a value has another width, or a pose is not finite.
        """
        pose_key, target_key, ee_key, contact_key, radius_key = self.in_keys
        object_pose = read_key(tensordict, pose_key, 3)
        target = read_key(tensordict, target_key, 2)
        ee_pose = read_key(tensordict, ee_key, 3)
        contact = read_key(tensordict, contact_key)
        check_dtype(repr(contact_key), contact, torch.bool)
        radius = read_key(tensordict, radius_key, 1)
        batch = object_pose.shape[:-1]
        if contact.shape != (*batch, 1):
            raise ValueError(f"{contact_key!r} must be {[*batch, 1]}, got {list(contact.shape)}.")
        target, ee_pose, contact, radius = (
            value.reshape(-1, value.shape[-1]) for value in (target, ee_pose, contact, radius)
        )
        position = object_pose.reshape(-1, 3)[:, :2]
        if not math.isfinite(torch.cat([position, target, ee_pose, radius], -1).sum()):
            given = (object_pose, target, ee_pose, radius)
            for key, value in zip([*self.in_keys[:3], radius_key], given, strict=True):
                check_finite(repr(key), value)
        action = scripted_push(position, target, ee_pose, contact, radius)
        tensordict.set(self.out_keys[0], action.reshape(*batch, 3))
        return tensordict
