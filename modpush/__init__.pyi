from .envs.push_env import PushEnv as PushEnv
from .evaluation.runner import evaluate as evaluate
from .recipes.paper import (
    PushEnvConfig as PushEnvConfig,
)
from .recipes.paper import (
    load_agent as load_agent,
)
from .recipes.paper import (
    make_push_env as make_push_env,
)
from .recipes.paper import (
    save_agent as save_agent,
)
from .training.trainer import Trainer as Trainer
