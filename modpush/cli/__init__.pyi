from .command import SUBCOMMANDS as SUBCOMMANDS, run_command as run_command
from .demo import DemoConfig as DemoConfig, show_demo as show_demo
from .evaluate import EvaluateConfig as EvaluateConfig, evaluate_policies as evaluate_policies
from .export import ExportConfig as ExportConfig
from .train import RunConfig as RunConfig, train_agent as train_agent
