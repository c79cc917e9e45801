"""`RenderedDepthCamera`: the depth image as SAPIEN renders it."""

from typing import TYPE_CHECKING, Any

import numpy as np
import sapien
from numpy.typing import NDArray

from modpush.envs.depth.base import DepthCamera
from modpush.envs.engines.sapien.engine import SapienEngine
from modpush.envs.engines.sapien.rendering import NO_RENDERER, camera_pose
from modpush.geometry.camera import CAMERA, Label

if TYPE_CHECKING:
    from modpush.envs.engines.sapien.task import PushTask


class RenderedDepthCamera(DepthCamera):
    """SAPIEN's own rendered camera: slow without a GPU; the analytic one is tested against it.

    Raises:
        ValueError: If the scenes are in another engine, or on CUDA.
        RuntimeError: If the scenes were built without a renderer.
    """

    needs_renderer = True

    def __init__(self, scenes: Any, arm_in_depth: bool = False) -> None:
        super().__init__(scenes, arm_in_depth)
        if not all(isinstance(engine, SapienEngine) for engine in scenes.engines):
            engines = sorted({engine.name for engine in scenes.engines})
            raise ValueError(
                "PushEnv: depth='sapien' is rendered in the engine 'sapien' on a CPU alone, got engine="
                f"{engines}; depth='analytic' gives the same image in any."
            )
        self._tasks = [engine.task for engine in scenes.engines]
        if not all(task.scene.can_render() for task in self._tasks):
            raise RuntimeError(NO_RENDERER)
        self._cameras = [self._add_camera(task.scene.sub_scenes[0]) for task in self._tasks]

    @staticmethod
    def _add_camera(scene: sapien.Scene) -> Any:
        # ManiSkill's cameras use another shader, whose depth is whole millimetres. The default one has
        # light and shadows, too: on a software device it takes 34 s for the first image instead of 0.1 s.
        sapien.render.set_camera_shader_dir("trivial")
        camera = scene.add_camera(
            "bird_eye_raw", CAMERA.width, CAMERA.height, CAMERA.field_of_view, near=0.01, far=10.0
        )
        sapien.render.set_camera_shader_dir("default")
        camera.entity.pose = camera_pose(CAMERA)
        return camera

    def reset(self, index: int) -> None:
        """Nothing: every image is rendered anew."""

    def capture(
        self, index: int, depth: NDArray[np.float32], segmentation: NDArray[np.uint8]
    ) -> None:
        """Render."""
        task, camera = self._tasks[index], self._cameras[index]
        if task.marker is not None:
            task.marker.hide_visual()  # until the next picture
        self._show_robot(task, self.arm_in_depth)
        task.scene.sub_scenes[0].update_render()
        camera.take_picture()
        np.copyto(depth, -camera.get_picture("Position")[..., 2])
        ids = camera.get_picture("Segmentation")[..., 1]
        segmentation[:] = Label.TABLE
        robot = [link._objs[0].entity for link in task.agent.robot.links]
        pushed = task.objects.actors[self.scenes.scenarios[index].pushed_object]._objs
        labelled = (
            (Label.OBJECT, pushed),
            (Label.OBSTACLE, task.obstacles.entities()),
            (Label.ROBOT, robot),
        )
        for label, entities in labelled:
            segmentation[np.isin(ids, [entity.per_scene_id for entity in entities])] = label
        self._show_robot(task, True)

    @staticmethod
    def _show_robot(task: "PushTask", visible: bool) -> None:
        for link in task.agent.robot.links:
            drawn = link._objs[0].entity.find_component_by_type(sapien.render.RenderBodyComponent)
            if drawn is not None:
                drawn.visibility = float(visible)
