from .agent_file import (
    Agent as Agent,
    load_agent as load_agent,
    save_agent as save_agent,
    shipped_agents as shipped_agents,
)
from .config import PushEnvConfig as PushEnvConfig
from .fingerprint import environment_fingerprint as environment_fingerprint
from .gym_env import PaperGymEnv as PaperGymEnv, PushGymEnv as PushGymEnv
from .make_env import make_push_env as make_push_env
from .methods import (
    METHODS as METHODS,
    Method as Method,
    get_method as get_method,
    get_methods as get_methods,
)
from .served import ServedPolicy as ServedPolicy
