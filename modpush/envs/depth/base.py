"""The interface of a depth camera, and what it may know of the scenes that it looks at."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from typing import Any, ClassVar, Protocol

import numpy as np
from numpy.typing import NDArray

from modpush.envs.robot.robot import Robot, Tool
from modpush.envs.scenes.objects import PushedObject
from modpush.envs.scenes.scenario import Scenario


class SceneView(Protocol):
    """State that a depth camera may read from one or several scenes.

    A transform is a position [m] and a quaternion (w, x, y, z) in the robot's base frame.
    """

    num_envs: int
    """Number of scenes."""
    scenarios: list[Scenario]
    """Start of the present episode of each scene."""
    dynamic_obstacles: bool
    """True if obstacles can be moved; if not, they stay where an episode's layout has them. Those with an
    `Obstacle.motion` move in any case."""
    pushed_objects: Sequence[PushedObject]
    """The objects that may be pushed in these scenes."""
    robot: Robot
    """The arm."""
    tool: Tool
    """Tool of the arm."""

    def object_transform_of(self, index: int) -> NDArray[np.float64]:
        """Transform of the pushed object of one scene, `[7]`."""

    def obstacle_transforms_of(self, index: int) -> NDArray[np.float64]:
        """Transforms of the obstacles of one scene, in the order of its layout, `[n, 7]`."""

    def link_transforms_of(self, index: int, names: Sequence[str]) -> NDArray[np.float64]:
        """Transforms of links of the arm of one scene, `[len(names), 7]`."""


class DepthCamera(ABC):
    """Implement `reset` and `capture` to observe scenes by your own depth camera.

    `PushEnv(depth=...)` calls the class, or any function, with a `SceneView` and `arm_in_depth`.

    Args:
        scenes: Scenes that the camera sees.
        arm_in_depth: True if the camera sees the arm.
    """

    needs_renderer: ClassVar[bool] = False
    """True if the scenes must be built with a renderer."""

    def __init__(self, scenes: SceneView, arm_in_depth: bool) -> None:
        self.scenes = scenes
        self.arm_in_depth = arm_in_depth

    @abstractmethod
    def reset(self, index: int) -> None:
        """Read the layout of scene `index`, at the beginning of each of its episodes."""

    @abstractmethod
    def capture(
        self, index: int, depth: NDArray[np.float32], segmentation: NDArray[np.uint8]
    ) -> None:
        """Write the present image of scene `index`.

        Args:
            index: Number of the scene.
            depth: `[H, W]`, to be written in full: depth along the optical axis [m].
            segmentation: `[H, W]`, to be written in full: values of `Label`.
        """


DepthCameraFactory = Callable[[Any, bool], DepthCamera]
"""`(SceneView, arm_in_depth) -> DepthCamera`; a class of cameras is one."""
