from .paper import (
    Agent as Agent,
)
from .paper import (
    PushEnvConfig as PushEnvConfig,
)
from .paper import (
    load_agent as load_agent,
)
from .paper import (
    make_push_env as make_push_env,
)
from .paper import (
    save_agent as save_agent,
)
