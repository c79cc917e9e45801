from .base import (
    Encoder as Encoder,
    as_floats as as_floats,
    check_window as check_window,
    encoder_sizes as encoder_sizes,
    evaluating as evaluating,
)
from .encode import ENCODERS as ENCODERS, Encode as Encode, make_encoder as make_encoder
from .networks import ConvEncoder as ConvEncoder, RayScan as RayScan
from .vae.model import DepthVAE as DepthVAE, VAELoss as VAELoss, shipped_weights as shipped_weights
from .window import (
    egocentric_window as egocentric_window,
)
from .window_transform import EgocentricWindow as EgocentricWindow
