from .base import Encoder as Encoder
from .base import as_floats as as_floats
from .base import check_window as check_window
from .base import encoder_sizes as encoder_sizes
from .base import evaluating as evaluating
from .encode import Encode as Encode
from .named import ENCODERS as ENCODERS
from .named import make_encoder as make_encoder
from .networks.conv_encoder import ConvEncoder as ConvEncoder
from .networks.ray_scan import RayScan as RayScan
from .vae.augmentation import augment_windows as augment_windows
from .vae.data import WindowData as WindowData
from .vae.loss import VAELoss as VAELoss
from .vae.model import DepthVAE as DepthVAE
from .vae.model import shipped_weights as shipped_weights
from .vae.quality import (
    Quality as Quality,
)
from .vae.quality import (
    encode_all as encode_all,
)
from .vae.quality import (
    linear_probe as linear_probe,
)
from .vae.quality import (
    mlp_probe as mlp_probe,
)
from .vae.quality import (
    r_squared as r_squared,
)
from .vae.quality import (
    vae_quality as vae_quality,
)
from .window import (
    cast_window as cast_window,
)
from .window import (
    egocentric_window as egocentric_window,
)
from .window import (
    window_pixels as window_pixels,
)
from .window_transform import EgocentricWindow as EgocentricWindow
