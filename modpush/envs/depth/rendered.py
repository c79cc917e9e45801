"""`RenderedDepthCamera`: the depth image as SAPIEN renders it."""

from typing import TYPE_CHECKING, Any

import numpy as np
import sapien
from numpy.typing import NDArray

from modpush.envs.depth.base import DepthCamera
from modpush.envs.sim.rendering import NO_RENDERER, camera_pose
from modpush.geometry.camera import CAMERA
from modpush.geometry.labels import Label

if TYPE_CHECKING:
    from modpush.envs.sim.task import ClutterPushEnv

__all__ = ["RenderedDepthCamera"]


class RenderedDepthCamera(DepthCamera):
    """SAPIEN's own rendered camera: slow without a GPU; the analytic one is tested against it.

    Args:
        task: The ManiSkill task whose scenes it looks at.
        arm_in_depth: Whether it sees the arm.

    Raises:
        RuntimeError: If the task was built without a renderer.
    """

    needs_renderer = True

    def __init__(self, task: "ClutterPushEnv", arm_in_depth: bool = False) -> None:
        super().__init__(task, arm_in_depth)
        self.task = task
        if not task.scene.can_render():
            raise RuntimeError(NO_RENDERER)
        self._cameras = [self._add_camera(scene) for scene in task.scene.sub_scenes]

    @staticmethod
    def _add_camera(scene: sapien.Scene) -> Any:
        # ManiSkill's cameras use another shader, whose depth is whole millimetres.
        sapien.render.set_camera_shader_dir("default")
        camera = scene.add_camera(
            "bird_eye_raw", CAMERA.width, CAMERA.height, CAMERA.field_of_view, near=0.01, far=10.0
        )
        camera.entity.pose = camera_pose(CAMERA)
        return camera

    def reset(self, index: int) -> None:
        """Nothing: every image is rendered anew."""

    def capture(
        self, index: int, depth: NDArray[np.float32], segmentation: NDArray[np.uint8]
    ) -> None:
        """Render."""
        task, camera = self.task, self._cameras[index]
        if task.gpu_sim_enabled:
            task.scene.px.sync_poses_gpu_to_cpu()
        task.hide_goal_marker()
        self._show_robot(index, self.arm_in_depth)
        task.scene.sub_scenes[index].update_render()
        camera.take_picture()
        np.copyto(depth, -camera.get_picture("Position")[..., 2])
        ids = camera.get_picture("Segmentation")[..., 1]
        segmentation[:] = Label.TABLE
        for label, entities in self._entities(index).items():
            segmentation[np.isin(ids, [entity.per_scene_id for entity in entities])] = label
        self._show_robot(index, True)

    def _entities(self, index: int) -> dict[int, list[sapien.Entity]]:
        task = self.task
        name = task.scenarios[index].pushed_object
        return {
            Label.OBJECT: [task.objects.actors[name]._objs[index]],
            Label.OBSTACLE: task.obstacles.entities(index),
            Label.ROBOT: [link._objs[index].entity for link in task.agent.robot.links],
        }

    def _show_robot(self, index: int, visible: bool) -> None:
        for link in self.task.agent.robot.links:
            drawn = link._objs[index].entity.find_component_by_type(
                sapien.render.RenderBodyComponent
            )
            if drawn is not None:
                drawn.visibility = float(visible)
