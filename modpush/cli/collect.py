"""Record demonstrations of any policies for offline learning, as a Minari data set.

    modpush collect --policy agent corridor --episodes 1000 --only-success
    modpush collect --policy scripted --env.scenario.scene free --env.scenario.difficulty 0 0.5 --images

Writes the data set and a card to `runs/demonstrations/`. The same again continues after an
interrupt; more episodes or further policies are added. It needs `pip install 'modpush[data]'`.
"""

from collections.abc import Sequence

from modpush.cli.options import parse_options
from modpush.data.config import CollectConfig

__all__ = ["main"]


def main(arguments: Sequence[str]) -> None:
    """`modpush collect <arguments>`."""
    config = parse_options(CollectConfig, "modpush collect", __doc__, arguments)
    from modpush.data.collecting import collect_demonstrations

    folder = collect_demonstrations(config)
    print((folder / "README.md").read_text(encoding="utf-8"))
    print(f"Wrote {folder}/.")
