"""`CameraModel`: a calibrated pinhole camera of any pose, by OpenCV's conventions."""

from collections.abc import Sequence
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray
from pydantic import Strict

from modpush._types import Finite, PixelCount, Position, Several
from modpush._validation import checked, from_plain
from modpush.files import read_yaml, reading, write_yaml

_Row3 = Annotated[tuple[Finite, Finite, Finite], Strict(False)]
_Row4 = Annotated[tuple[Finite, Finite, Finite, Finite], Strict(False)]
_Matrix3 = Annotated[tuple[_Row3, _Row3, _Row3], Strict(False)]
_Matrix4 = Annotated[tuple[_Row4, _Row4, _Row4, _Row4], Strict(False)]
_ImageSize = Annotated[tuple[PixelCount, PixelCount], Strict(False)]

_NUM_COEFFICIENTS = (0, 4, 5, 8, 12, 14)  # of OpenCV's distortion model
_KIND = "modpush camera"
_OPENCV = b"%YAML"  # first bytes of a file of cv2.FileStorage
_TOLERANCE = 1e-4  # of a rotation matrix that a person has typed


@checked
class CameraModel:
    """A calibrated pinhole camera of any pose.

    Pixels are (u, v) = (column, row) with centres at integers. The camera's own axes are OpenCV's: x to
    the right in the image, y down, z along the optical axis. Depth is measured along z, as depth cameras
    give it, and not along the ray.

    Raises:
        ValueError: If a matrix is not of its form, the number of distortion coefficients is none that
            OpenCV knows, or a number is not finite.
    """

    size: _ImageSize
    """Width and height of the image [px]."""
    intrinsics: _Matrix3
    """OpenCV's camera matrix ((fx, 0, cx), (0, fy, cy), (0, 0, 1)) [px], without skew."""
    camera_in_base: _Matrix4
    """Pose of the camera: the transform from its axes to the robot's base frame [m]."""
    distortion: Several[Finite] = ()
    """OpenCV's coefficients (k1, k2, p1, p2, k3, ...), 4, 5, 8, 12 or 14; none for an image without
    distortion, such as the rectified depth image of a stereo camera."""

    def __post_init__(self) -> None:
        (fx, skew, _), (zero, fy, _), last = self.intrinsics
        if (skew, zero, *last) != (0, 0, 0, 0, 1) or not (fx > 0 and fy > 0):
            raise ValueError(
                "CameraModel: intrinsics must be ((fx, 0, cx), (0, fy, cy), (0, 0, 1)) with fx and "
                f"fy > 0, got {self.intrinsics}."
            )
        if len(self.distortion) not in _NUM_COEFFICIENTS:
            raise ValueError(
                f"CameraModel: distortion must be {_NUM_COEFFICIENTS} coefficients (k1, k2, p1, p2, k3, "
                f"...), got {len(self.distortion)}."
            )
        pose = np.array(self.camera_in_base)
        turn = pose[:3, :3]
        if self.camera_in_base[3] != (0, 0, 0, 1) or (
            np.abs(turn @ turn.T - np.eye(3)).max() > _TOLERANCE or np.linalg.det(turn) < 0
        ):
            raise ValueError(
                "CameraModel: camera_in_base must be a rotation matrix and a position, with the last row "
                f"(0, 0, 0, 1), got {self.camera_in_base}."
            )

    @classmethod
    def looking_at(
        cls,
        target: Sequence[float],
        position: Sequence[float],
        size: tuple[int, int] = (640, 480),
        focal_length: float = 520.0,
        up: Sequence[float] = (0.0, 0.0, 1.0),
        distortion: Sequence[float] = (),
    ) -> "CameraModel":
        """A camera at a position, turned towards a point, with its principal point in the image's middle.

        Args:
            target: The point (x, y, z) that is seen in the image's middle [m].
            position: The pinhole (x, y, z) [m].
            size: Width and height of the image [px].
            focal_length: Focal length [px].
            up: A direction that points up in the image, not along the optical axis.
            distortion: See `CameraModel`.

        Raises:
            ValueError: If the target is the position, or `up` points along the optical axis.
        """
        place = np.array(position, dtype=np.float64)
        forward = np.array(target, dtype=np.float64) - place
        right = np.cross(forward, np.array(up, dtype=np.float64))
        if not np.linalg.norm(right) > 1e-9:
            raise ValueError(
                "CameraModel.looking_at: target, position and up must span a plane, got "
                f"{tuple(target)}, {tuple(position)} and {tuple(up)}."
            )
        forward, right = forward / np.linalg.norm(forward), right / np.linalg.norm(right)
        pose: Any = np.eye(4)
        pose[:3] = np.stack([right, np.cross(forward, right), forward, place], axis=1)
        (width, height), f = size, float(focal_length)
        rows = ((f, 0.0, 0.5 * (width - 1)), (0.0, f, 0.5 * (height - 1)), (0.0, 0.0, 1.0))
        return cls(
            size=size,
            intrinsics=rows,
            camera_in_base=pose.tolist(),
            distortion=tuple(float(k) for k in distortion),
        )

    @classmethod
    def load(cls, path: Path | str) -> "CameraModel":
        """Read a camera from YAML or JSON: what `save` wrote, or what a person or OpenCV did.

        A file of `cv2.FileStorage` (its first line begins with `%YAML`) has OpenCV's names `image_width`,
        `image_height`, `camera_matrix` and `distortion_coefficients`, and `camera_in_base` beside them.

        Raises:
            FileNotFoundError: If there is no such file.
            ValueError: If it is damaged, or something is missing or wrong; the message names it.
        """
        with reading(path, _KIND):
            is_opencv = Path(path).read_bytes().startswith(_OPENCV)
            data = _read_opencv(Path(path)) if is_opencv else read_yaml(path, _KIND)
            return from_plain(cls, data)

    def save(self, path: Path | str) -> None:
        """Write a YAML file, which a person can read and edit."""
        data = {
            "size": list(self.size),
            "intrinsics": [list(row) for row in self.intrinsics],
            "distortion": list(self.distortion),
            "camera_in_base": [list(row) for row in self.camera_in_base],
        }
        write_yaml(path, data, _KIND, 1)

    @property
    def position(self) -> Position:
        """The pinhole (x, y, z) in the robot's base frame [m]."""
        (*_, x), (*_, y), (*_, z), _ = self.camera_in_base
        return x, y, z

    @cached_property
    def base_in_camera(self) -> NDArray[np.float64]:
        """The transform from the robot's base frame to the camera's axes, `[4, 4]`."""
        return np.linalg.inv(np.array(self.camera_in_base))

    @cached_property
    def rays(self) -> NDArray[np.float32]:
        """The ray of each pixel in the base frame, scaled to 1 along the optical axis, `[H, W, 3]`.

        A pixel with depth d shows the point `position + d * ray`. Distortion is removed.
        """
        import cv2

        width, height = self.size
        v, u = np.indices((height, width), dtype=np.float64)
        pixels = np.stack([u, v], -1).reshape(-1, 1, 2)
        criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 50, 1e-9)
        flat = cv2.undistortPoints(
            pixels, np.array(self.intrinsics), np.array(self.distortion), criteria=criteria
        )
        own = np.insert(flat.reshape(-1, 2), 2, 1.0, axis=1)
        turned = own @ np.array(self.camera_in_base)[:3, :3].T
        rays = np.ascontiguousarray(turned.reshape(height, width, 3), dtype=np.float32)
        rays.setflags(write=False)
        return rays

    def project(
        self, points: NDArray[np.floating]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Project points to pixels.

        Args:
            points: `[..., 3]` (x, y, z) in the base frame [m].

        Returns:
            Pixels `[..., 2]` (u, v), with distortion, and depth along the optical axis `[...]` [m].
            Pixels of points that are not in front of the camera are NaN.
        """
        import cv2

        transform = self.base_in_camera
        own = np.asarray(points, dtype=np.float64) @ transform[:3, :3].T + transform[:3, 3]
        depth = own[..., 2]
        flat = own.reshape(-1, 3)
        if not len(flat):
            return np.zeros((*depth.shape, 2)), depth
        ahead = flat[:, 2] > 1e-9
        flat = np.where(ahead[:, None], flat, (0.0, 0.0, 1.0))
        pixels, _ = cv2.projectPoints(
            flat, np.zeros(3), np.zeros(3), np.array(self.intrinsics), np.array(self.distortion)
        )
        pixels = np.where(ahead[:, None], pixels.reshape(-1, 2), np.nan)
        return pixels.reshape(*depth.shape, 2), depth

    def points(self, depth: NDArray[np.floating]) -> NDArray[np.float32]:
        """Points in the base frame that a depth image shows, `[H, W, 3]` [m].

        Args:
            depth: `[H, W]` along the optical axis [m]. Pixels without a reading (0, negative or not
                finite) give NaN.

        Raises:
            ValueError: If the image has another size than the camera.
        """
        width, height = self.size
        if np.shape(depth) != (height, width):
            raise ValueError(
                f"CameraModel: depth must be [{height}, {width}], got {list(np.shape(depth))}."
            )
        image = np.asarray(depth, dtype=np.float32)
        image = np.where(np.isfinite(image) & (image > 0), image, np.float32(np.nan))
        return np.array(self.position, dtype=np.float32) + image[..., None] * self.rays


def _read_opencv(path: Path) -> dict[str, Any]:
    """Plain data from a file of `cv2.FileStorage`."""
    import cv2

    try:
        storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_READ)
        matrices = {
            name: storage.getNode(name).mat()
            for name in ("camera_matrix", "distortion_coefficients", "camera_in_base")
        }
        size = [int(storage.getNode(f"image_{side}").real()) for side in ("width", "height")]
        storage.release()
    except (cv2.error, SystemError) as error:  # of which the second is its binding's
        raise ValueError(f"{_KIND}: {path} cannot be read by cv2.FileStorage: {error}.") from error
    for name in ("camera_matrix", "camera_in_base"):
        if matrices[name] is None:
            raise ValueError(f"{_KIND}: {name} is missing in {path}.")
    coefficients = matrices["distortion_coefficients"]
    return {
        "size": size,
        "intrinsics": matrices["camera_matrix"].tolist(),
        "distortion": [] if coefficients is None else coefficients.ravel().tolist(),
        "camera_in_base": matrices["camera_in_base"].tolist(),
    }
