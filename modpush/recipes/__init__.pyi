from .agent_file import Agent as Agent
from .agent_file import load_agent as load_agent
from .agent_file import save_agent as save_agent
from .agent_file import shipped_agents as shipped_agents
from .config import PushEnvConfig as PushEnvConfig
from .fingerprint import environment_fingerprint as environment_fingerprint
from .make_env import make_push_env as make_push_env
