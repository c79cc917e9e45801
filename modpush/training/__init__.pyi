from .config import TRAIN_PRESETS as TRAIN_PRESETS
from .config import TrainConfig as TrainConfig
from .run_folder import check_run_folder as check_run_folder
from .trainer import Trainer as Trainer
