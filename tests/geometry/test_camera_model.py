"""Projection against OpenCV's, points against the camera's own pose, and files."""

import pickle
import re
from pathlib import Path

import cv2
import numpy as np
import pytest

from modpush.geometry import CameraModel

TILTED = CameraModel.looking_at(
    (0.5, 0.0, 0.0), (1.0, 0.1, 0.9), distortion=(0.1, -0.05, 0.001, 0.002)
)
PAGE = Path(__file__).parents[2] / "docs/howto/camera.md"
STRAIGHT = CameraModel.looking_at((0.6, 0.0, 0.0), (0.6, 0.0, 1.1), up=(1.0, 0.0, 0.0))


def test_the_target_is_seen_in_the_middle_at_its_distance() -> None:
    pixel, depth = TILTED.project(np.array([0.5, 0.0, 0.0]))
    assert pixel == pytest.approx([319.5, 239.5])
    assert depth == pytest.approx(np.sqrt(0.5**2 + 0.1**2 + 0.9**2))


def test_x_is_right_y_is_down_and_z_is_ahead() -> None:
    # Looking down with the base's x up in the image: left (+y) is left, as in the policy's camera.
    (ahead, left), depth = STRAIGHT.project(np.array([[0.7, 0.0, 0.1], [0.6, 0.1, 0.1]]))
    assert depth == pytest.approx([1.0, 1.0])
    assert ahead == pytest.approx([319.5, 239.5 - 52.0])  # 0.1 m at 1 m and 520 px
    assert left == pytest.approx([319.5 - 52.0, 239.5])


def test_projection_is_opencv_s_with_distortion() -> None:
    rng = np.random.default_rng(0)
    points = rng.uniform((0.2, -0.3, 0.0), (0.8, 0.3, 0.1), (50, 3))
    in_camera = np.linalg.inv(np.array(TILTED.camera_in_base))
    expected, _ = cv2.projectPoints(
        points,
        cv2.Rodrigues(in_camera[:3, :3])[0],
        in_camera[:3, 3],
        np.array(TILTED.intrinsics),
        np.array(TILTED.distortion),
    )
    assert TILTED.project(points)[0] == pytest.approx(expected[:, 0], abs=1e-6)


def test_points_of_a_depth_image_project_to_their_pixels() -> None:
    depth = np.random.default_rng(1).uniform(0.5, 1.5, (480, 640)).astype(np.float32)
    depth[0, 0], depth[3, 5] = 0.0, np.inf
    points = TILTED.points(depth)
    assert np.isnan(points[0, 0]).all()
    assert np.isnan(points[3, 5]).all()
    v, u = 70, 600
    pixel, along = TILTED.project(points[v, u])
    assert pixel == pytest.approx([u, v], abs=1e-3)
    assert along == pytest.approx(depth[v, u], abs=1e-5)


def test_what_is_behind_the_camera_has_no_pixel() -> None:
    pixel, depth = TILTED.project(np.array([[2.0, 0.2, 2.0]]))
    assert np.isnan(pixel).all()
    assert depth[0] < 0
    assert TILTED.project(np.zeros((0, 3)))[0].shape == (0, 2)


@pytest.mark.parametrize("ending", ["yaml", "json"])
def test_a_camera_survives_its_file(tmp_path, ending) -> None:
    path = tmp_path / f"camera.{ending}"
    TILTED.save(path)
    assert CameraModel.load(path) == TILTED
    assert pickle.loads(pickle.dumps(TILTED)) == TILTED


def test_a_file_typed_by_hand_is_read(tmp_path) -> None:
    path = tmp_path / "camera.json"
    path.write_text(
        '{"size": [640, 480], "intrinsics": [[520, 0, 319.5], [0, 520, 239.5], [0, 0, 1]],'
        ' "camera_in_base": [[0, -1, 0, 0.6], [-1, 0, 0, 0], [0, 0, -1, 1.1], [0, 0, 0, 1]]}',
        encoding="utf-8",
    )
    camera = CameraModel.load(path)
    assert camera.position == (0.6, 0.0, 1.1)
    assert camera.distortion == ()


def test_opencv_s_own_file_is_read(tmp_path) -> None:
    path = tmp_path / "calibration.yml"
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    storage.write("image_width", 640)
    storage.write("image_height", 480)
    storage.write("camera_matrix", np.array(TILTED.intrinsics))
    storage.write("distortion_coefficients", np.array(TILTED.distortion)[:, None])
    storage.write("camera_in_base", np.array(TILTED.camera_in_base))
    storage.release()
    loaded = CameraModel.load(path)
    assert loaded.size == TILTED.size
    assert np.allclose(loaded.camera_in_base, TILTED.camera_in_base, atol=1e-12)
    assert loaded.distortion == pytest.approx(TILTED.distortion)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"intrinsics": np.diag([520.0, -520.0, 1.0])}, "fx and fy > 0"),
        ({"camera_in_base": np.diag([1.0, 1.0, -1.0, 1.0])}, "rotation matrix"),
        ({"camera_in_base": 2 * np.eye(4)}, "rotation matrix"),
        ({"distortion": (0.1,)}, "distortion must be"),
        ({"size": (640,)}, "size"),
    ],
)
def test_a_wrong_camera_is_refused(change, message) -> None:
    given = {
        "size": TILTED.size,
        "intrinsics": TILTED.intrinsics,
        "camera_in_base": TILTED.camera_in_base,
    }
    with pytest.raises(ValueError, match=message):
        CameraModel(**{**given, **change})


def test_a_file_without_an_entry_is_refused_by_name(tmp_path) -> None:
    path = tmp_path / "camera.yaml"
    path.write_text("size: [640, 480]\n", encoding="utf-8")
    with pytest.raises(ValueError, match=r"camera\.yaml.*intrinsics"):
        CameraModel.load(path)
    path.write_bytes(b"%YAML:1.0\n---\nimage_width: 640\nimage_height: 480\n")
    with pytest.raises(ValueError, match="camera_matrix is missing"):
        CameraModel.load(path)
    path.write_bytes(b"%YAML:1.0\n---\nimage_width: [640\n")
    with pytest.raises(ValueError, match="cannot be read"):
        CameraModel.load(path)


def test_the_file_on_the_page_is_the_camera_of_its_example(tmp_path) -> None:
    """As it stands, and as somebody types it who rounds to three digits."""
    (written,) = re.findall(r"```yaml\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)
    expected = CameraModel.looking_at(target=(0.5, 0.0, 0.0), position=(1.0, 0.0, 0.866))
    for text in (written, written.replace("0.866025", "0.866")):
        (tmp_path / "camera.yaml").write_text(text, encoding="utf-8")
        camera = CameraModel.load(tmp_path / "camera.yaml")
        assert np.allclose(camera.camera_in_base, expected.camera_in_base, atol=1e-4)
        assert camera.intrinsics == expected.intrinsics
