from .camera import CAMERA as CAMERA
from .camera import Camera as Camera
from .grid import (
    SEGMENT_OBJECT as SEGMENT_OBJECT,
)
from .grid import (
    SEGMENT_OBSTACLE as SEGMENT_OBSTACLE,
)
from .grid import (
    SEGMENT_ROBOT as SEGMENT_ROBOT,
)
from .grid import (
    SEGMENT_TABLE as SEGMENT_TABLE,
)
from .grid import (
    GridFrame as GridFrame,
)
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
