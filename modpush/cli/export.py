"""Write an agent's policy as ONNX or torch.export graphs, with a card.

    modpush export small_cube
    modpush export runs/train --format onnx torch_export --out runs/exported

Writes `policy` (observation to action), `window_policy` (local window and state to action, encoder
included) and `card.json`, which describes inputs and outputs. ONNX needs `pip install
'modpush[export]'`; `examples/deploy.py` pushes with such a folder as with an agent.

Arguments:
  AGENT               Shipped agent by its name, an agent's file, or a training run's folder; by
                      default small_cube.

Options:
  --format NAME ...   Formats of the graphs, onnx and torch_export; by default onnx.
  --out FOLDER        Folder to write to; by default runs/exported.
  --allow MODULE ...  Modules from which an agent's file may import its author's own parts.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import torch
import tyro

from modpush._types import AtLeastOne, FilePath, Name, Several
from modpush._validation import checked
from modpush.export.agent import Format, export_agent
from modpush.recipes.agent_file import load_agent


@checked
class ExportConfig:
    """Agent to export, formats, and folder to write to; this module's docstring explains the options."""

    agent: tyro.conf.Positional[Name] = "small_cube"
    formats: Annotated[AtLeastOne[Format], tyro.conf.arg(name="format")] = ("onnx",)
    out: FilePath = Path("runs/exported")
    allow: Several[Name] = ()


def main(arguments: Sequence[str]) -> None:
    """`modpush export <arguments>`."""
    torch.set_num_threads(1)
    config = tyro.cli(ExportConfig, prog="modpush export", args=[*arguments])
    agent = load_agent(config.agent, allow=config.allow)
    for path in export_agent(agent, config.out, config.formats).values():
        print(f"{path}  {path.stat().st_size / 1e6:.2f} MB")
