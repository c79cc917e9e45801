from .command import SUBCOMMANDS as SUBCOMMANDS
from .command import run_command as run_command
from .demo import DemoConfig as DemoConfig
from .demo import show_demo as show_demo
from .evaluate import EvaluateConfig as EvaluateConfig
from .evaluate import evaluate_policies as evaluate_policies
from .train import RunConfig as RunConfig
from .train import train_agent as train_agent
