import json

import numpy as np
import pytest

from modpush.envs import SCENES, PushedObject, PushEnv
from modpush.envs.engines.sapien.rendering import NO_RENDERER, find_render_device
from modpush.geometry import box, centered


def test_the_centre_of_mass_of_unequal_parts_keeps_its_height() -> None:
    parts = centered(box(0.06, 0.06, 0.02), box(0.02, 0.02, 0.06, (0.0, 0.0, 0.04)))
    item = PushedObject(name="pawn", parts=parts, symmetry=4)
    env = PushEnv(1, pushed_object=item, depth=None, seed=0)
    env.reset()
    body = env._batch.engines[0].task.objects.actors["pawn"]._bodies[0]
    masses = [0.06 * 0.06 * 0.02, 0.02 * 0.02 * 0.06]
    expected = np.average([part.position[2] for part in parts], weights=masses)
    assert expected < -0.01
    assert body.cmass_local_pose.p == pytest.approx([0, 0, expected], abs=1e-5)
    env.close()


def test_layouts_change_from_episode_to_episode_without_rebuilding() -> None:
    env = PushEnv(1, scene=tuple(SCENES), depth=None, seed=0)
    task = env._batch.engines[0].task
    scene = task.scene
    for _ in range(20):
        env.reset()
        standing = env.scenarios[0].obstacles
        assert len(task.obstacles.rigid_bodies()) == len(standing)
        expected = np.array([o.pose[:2] for o in standing]).reshape(-1, 2)
        np.testing.assert_allclose(task.obstacles.transforms()[:, :2], expected, atol=1e-5)
    assert task.scene is scene
    env.close()


def test_pictures_without_a_renderer_say_how_to_get_one() -> None:
    if find_render_device() is not None:
        pytest.skip("there is a renderer")
    with pytest.raises(RuntimeError, match="No Vulkan device"):
        PushEnv(1, pictures=True)


def test_a_broken_vulkan_driver_does_not_take_the_process_down(tmp_path, monkeypatch) -> None:
    driver = tmp_path / "broken.so"
    driver.write_bytes(b"this is no library")
    icd = tmp_path / "broken.json"
    about = {"library_path": str(driver), "api_version": "1.3.0"}
    icd.write_text(json.dumps({"file_format_version": "1.0.0", "ICD": about}))
    monkeypatch.setenv("VK_ICD_FILENAMES", str(icd))
    monkeypatch.setenv("VK_DRIVER_FILES", str(icd))
    assert find_render_device() is None
    assert "make renderer" in NO_RENDERER
