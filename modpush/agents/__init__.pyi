from .corridor.config import CorridorConfig as CorridorConfig
from .corridor.config import faithful_config as faithful_config
from .corridor.controller import PushingCorridorController as PushingCorridorController
from .scripted import ScriptedPusher as ScriptedPusher
from .scripted import ScriptedPusherConfig as ScriptedPusherConfig
from .tqc.build import (
    TQCAgent as TQCAgent,
)
from .tqc.build import (
    TQCConfig as TQCConfig,
)
from .tqc.build import (
    make_tqc as make_tqc,
)
from .tqc.build import (
    make_tqc_from_specs as make_tqc_from_specs,
)
from .tqc.loss import TQCLoss as TQCLoss
from .tqc.networks import make_actor as make_actor
from .tqc.networks import make_critic as make_critic
from .tqc.quantiles import quantile_huber as quantile_huber
from .tqc.quantiles import truncate_atoms as truncate_atoms
from .tqc.update import TQCUpdate as TQCUpdate
