from .envs.push_env import PushEnv as PushEnv
from .evaluation.runner import evaluate as evaluate
from .recipes.agent_file import load_agent as load_agent, save_agent as save_agent
from .recipes.config import PushEnvConfig as PushEnvConfig
from .recipes.make_env import make_push_env as make_push_env
from .training.trainer import Trainer as Trainer

__version__: str
