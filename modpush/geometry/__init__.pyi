from .camera import CAMERA as CAMERA, Camera as Camera, Label as Label
from .camera_model import CameraModel as CameraModel
from .footprint import centered as centered
from .frames import (
    Frame as Frame,
    frame_yaw as frame_yaw,
    rotate as rotate,
    wrap_angle as wrap_angle,
)
from .shapes import (
    Primitive as Primitive,
    box as box,
    capsule as capsule,
    cylinder as cylinder,
    prism as prism,
)
from .workspace import (
    BOUNDS_MARGIN as BOUNDS_MARGIN,
    WORKSPACE as WORKSPACE,
    Rectangle as Rectangle,
)
