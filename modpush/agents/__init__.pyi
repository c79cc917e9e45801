from .corridor.config import CorridorConfig as CorridorConfig, faithful_config as faithful_config
from .corridor.controller import PushingCorridorController as PushingCorridorController
from .scripted import ScriptedPusher as ScriptedPusher
from .tqc.build import (
    TQCAgent as TQCAgent,
    make_tqc as make_tqc,
    make_tqc_from_specs as make_tqc_from_specs,
)
from .tqc.config import TQCConfig as TQCConfig
from .tqc.encoder import (
    EncodedNetwork as EncodedNetwork,
    EncoderTQCLoss as EncoderTQCLoss,
    encode_images as encode_images,
)
from .tqc.factories import LearnerSpecs as LearnerSpecs
from .tqc.loss import TQCLoss as TQCLoss
from .tqc.networks import make_actor as make_actor, make_critic as make_critic
from .tqc.quantiles import quantile_huber as quantile_huber, truncate_atoms as truncate_atoms
from .tqc.update import TQCUpdate as TQCUpdate
