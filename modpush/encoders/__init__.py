"""The local window around the object, and networks that make a few numbers of it.

Needs no simulator: any depth image, any pose.
"""

from .augmentation import augment_windows
from .base import Encoder, check_window
from .conv_encoder import ConvEncoder
from .depth_vae import DepthVAE, shipped_weights
from .egocentric_window import EgocentricWindow
from .encode import Encode
from .quality import Quality, encode_all, linear_probe, mlp_probe, r_squared, vae_quality
from .ray_scan import RayScan
from .vae_loss import VAELoss
from .window import cast_window, egocentric_window, window_pixels
from .window_data import WindowData

__all__ = [
    "ConvEncoder",
    "DepthVAE",
    "EgocentricWindow",
    "Encode",
    "Encoder",
    "Quality",
    "RayScan",
    "VAELoss",
    "WindowData",
    "augment_windows",
    "cast_window",
    "check_window",
    "egocentric_window",
    "encode_all",
    "linear_probe",
    "mlp_probe",
    "r_squared",
    "shipped_weights",
    "vae_quality",
    "window_pixels",
]
