"""Record demonstrations of any policies for offline learning, as a Minari data set.

    modpush collect --policy agent corridor --episodes 1000 --only-success
    modpush collect --policy scripted --env.scenario.scene free --env.scenario.difficulty 0 0.5 --images

Writes the data set and a card to `runs/demonstrations/`. After an interrupt the data set holds the
episodes until then. It needs `pip install 'modpush[data]'`.

Options:
  --policy NAME ...   Policies to record: agent (the shipped one for all objects), a shipped agent by
                      its name, corridor, corridor_faithful, scripted, a training run's folder, or an
                      agent's file; by default agent. Each episode is labelled with its policy's name.
  --episodes N        Number of episodes to keep for each policy; by default 100.
  --only-success      Keep only episodes that reach the goal; failed ones are replaced by further ones.
  --images            Also store depth and segmentation images, some 2 kB a step.
  --env.FIELD X       Field of the environment whose observations, actions and rewards are recorded,
                      such as --env.scenario.scene, --env.scenario.pushed-object or --env.encoder; by
                      default that of the preset cpu. docs/train_options.md lists all, as
                      --train.env.FIELD.
  --seed N            Seed of the starts; by default 0. Different seeds have different starts, and none
                      is in an evaluation set.
  --name NAME         Name of the data set: letters, digits and underscores; by default push. Minari calls
                      it modpush/NAME-v0.
  --licence NAME      Licence that the card states; by default MIT.
  --out FOLDER        Folder to write to, without a data set; by default runs/demonstrations.
  --allow MODULE ...  Modules from which an agent's file may import its author's own parts.
"""

from collections.abc import Sequence

import tyro

from modpush.data.collecting import CollectConfig, collect_demonstrations


def main(arguments: Sequence[str]) -> None:
    """`modpush collect <arguments>`."""
    config = tyro.cli(CollectConfig, prog="modpush collect", args=[*arguments])
    folder = collect_demonstrations(config)
    print((folder / "README.md").read_text(encoding="utf-8"))
    print(f"Wrote {folder}/.")
