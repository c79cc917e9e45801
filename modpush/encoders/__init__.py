"""The local window around the object, and networks that make a few numbers of it.

Needs no simulator: any depth image, any pose.
"""

from .base import Encoder, check_window
from .conv_encoder import ConvEncoder
from .depth_vae import DepthVAE
from .egocentric_window import EgocentricWindow
from .encode import Encode
from .ray_scan import RayScan
from .window import cast_window, egocentric_window, window_pixels
from .window_data import WindowData

__all__ = [
    "ConvEncoder",
    "DepthVAE",
    "EgocentricWindow",
    "Encode",
    "Encoder",
    "RayScan",
    "WindowData",
    "cast_window",
    "check_window",
    "egocentric_window",
    "window_pixels",
]
