from .config import TrainConfig as TrainConfig
from .held_out import held_out_scenarios as held_out_scenarios
from .learner import NonFiniteLossError as NonFiniteLossError
from .presets import TRAIN_PRESETS as TRAIN_PRESETS
from .run_folder import RunFolder as RunFolder, check_run_folder as check_run_folder
from .scene_worker import EnvFactory as EnvFactory
from .trainer import Trainer as Trainer
