"""Record demonstrations of any policies for offline learning, as Minari and ManiSkill data sets.

    modpush collect --policy agent corridor --episodes 1000 --only-success
    modpush collect --policy scripted --env.scenario.scene free --env.scenario.difficulty 0 0.5 --images

Writes both data sets and a card to `runs/demonstrations/`. An interrupted run continues where it
stopped, and one that asks for more episodes adds them. It needs `pip install 'modpush[data]'`.
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
