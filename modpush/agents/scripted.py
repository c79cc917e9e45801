"""A scripted pusher: it moves behind the object, pushes it to the target and corrects the direction."""

import math

import torch
from tensordict import NestedKey, TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor

from modpush._checks import check_dtype, check_finite, read_key
from modpush._types import Finite, HalfTurn, Length, NonNegative, Positive, PositiveFraction
from modpush._validation import checked, checked_arguments
from modpush.geometry.frames import wrap_angle


@checked
class ScriptedPusherConfig:
    """Gains of the scripted pusher, tuned by hand in free space."""

    tool_radius: Length = 0.034
    """Circumscribed radius of the tool's tip [m]."""
    margin: NonNegative = 0.012
    """Distance between tool and object while the tool goes around the object [m]."""
    approach_angle: HalfTurn = 0.15
    """Largest angle from the line through target and object at which the tool approaches [rad]."""
    push_angle: HalfTurn = 0.7
    """Largest angle from that line at which a tool in contact continues to push [rad]."""
    steer_gain: Finite = 1.5
    """Correction of the pushing direction, as a multiple of the angle from the line."""
    push_speed: PositiveFraction = 0.7
    """Length of a step while in contact, as a fraction of the largest step."""
    max_turn: Positive = 0.05
    """Rotation of the tool by an action of 1 [rad]."""

    def __post_init__(self) -> None:
        """Check the relations between fields."""
        if not self.approach_angle <= self.push_angle:
            raise ValueError(
                "ScriptedPusherConfig: expected approach_angle <= push_angle, "
                f"got {self.approach_angle} and {self.push_angle}."
            )


def scripted_push(
    object_position: Tensor,
    target: Tensor,
    ee_pose: Tensor,
    contact: Tensor,
    object_radius: Tensor,
    config: ScriptedPusherConfig,
) -> Tensor:
    """The next action of the scripted pusher.

    Args:
        object_position: Position of the object, `[B, 2]` [m].
        target: Target of the object, `[B, 2]` [m].
        ee_pose: x, y, yaw of the tool's tip, `[B, 3]` [m, m, rad].
        contact: Contact between tool and object, `[B, 1]` bool.
        object_radius: Circumscribed radius of the object, `[B, 1]` [m].
        config: Gains of the pusher.

    Returns:
        Actions, `[B, 3]` in [-1, 1].
    """
    to_object = object_position - ee_pose[:, :2]
    to_target = target - object_position
    distance = torch.linalg.vector_norm(to_object, dim=-1)
    bearing, heading = _angle(to_object), _angle(to_target)
    off = wrap_angle(bearing - heading)  # 0: the tool is right behind the object
    behind = off.abs() < torch.where(contact[:, 0], config.push_angle, config.approach_angle)

    push = _unit(heading + (1 + config.steer_gain) * off)
    push = push * torch.where(contact[:, 0], config.push_speed, 1.0).to(push)[:, None]

    # Around the object on a circle, the shorter way; far from the circle, towards it.
    circle = object_radius[:, 0] + config.tool_radius + config.margin
    side = torch.where(off > 0, 1.0, -1.0).to(off)
    inwards = ((distance - circle) / 0.02).clamp(-1.2, 1.2)
    around = _unit(bearing + side * (math.pi / 2 - inwards))

    move = torch.where(behind[:, None], push, around)
    # The wide side of the gripper faces the pushing direction; half a turn makes no difference.
    turn = wrap_angle(2 * (heading + math.pi / 2 - ee_pose[:, 2])) / 2
    action = torch.cat([move, (turn / config.max_turn)[:, None]], -1)
    return action.clamp(-1.0, 1.0)


def _angle(vector: Tensor) -> Tensor:
    return torch.atan2(vector[..., 1], vector[..., 0])


def _unit(angle: Tensor) -> Tensor:
    return torch.stack([torch.cos(angle), torch.sin(angle)], -1)


class ScriptedPusher(TensorDictModuleBase):
    """The scripted pusher as a policy without state.

    It ignores obstacles and pushes straight towards its target. Give it a planner's sub-goals
    (`target_key="subgoal"`) to push along a path.

    Args:
        config: Gains of the pusher; the tuned ones by default.
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
        config: ScriptedPusherConfig | None = None,
        *,
        target_key: NestedKey = "goal_position",
        object_pose_key: NestedKey = "object_pose",
        ee_pose_key: NestedKey = "ee_pose",
        contact_key: NestedKey = "object_contact",
        object_radius_key: NestedKey = "object_radius",
        action_key: NestedKey = "action",
    ) -> None:
        super().__init__()
        self.config = config if config is not None else ScriptedPusherConfig()
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
        action = scripted_push(position, target, ee_pose, contact, radius, self.config)
        tensordict.set(self.out_keys[0], action.reshape(*batch, 3))
        return tensordict
