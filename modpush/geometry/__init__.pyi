from .angles import (
    rotate as rotate,
)
from .angles import (
    wrap_angle as wrap_angle,
)
from .camera import CAMERA as CAMERA
from .camera import Camera as Camera
from .footprint import centered as centered
from .frames import (
    Frame as Frame,
)
from .frames import (
    check_frame as check_frame,
)
from .frames import (
    frame_yaw as frame_yaw,
)
from .labels import Label as Label
from .shapes import (
    Primitive as Primitive,
)
from .shapes import (
    box as box,
)
from .shapes import (
    capsule as capsule,
)
from .shapes import (
    cylinder as cylinder,
)
from .shapes import (
    prism as prism,
)
from .workspace import (
    BOUNDS_MARGIN as BOUNDS_MARGIN,
)
from .workspace import (
    WORKSPACE as WORKSPACE,
)
from .workspace import (
    Rectangle as Rectangle,
)
