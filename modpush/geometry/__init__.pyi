from .camera import CAMERA as CAMERA
from .camera import Camera as Camera
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
