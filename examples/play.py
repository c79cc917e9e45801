"""Watch policies push in the browser, and change the scene while they do.

    python examples/play.py                              # the shipped agent any_object, at http://127.0.0.1:8080
    python examples/play.py --policy agent corridor      # two policies side by side on one scene
    python examples/play.py --policy hand --scene posts  # drive it yourself: keys I, J, K, L, U, O
    python examples/play.py runs/evaluate/any_object     # the stored episodes of an evaluation

Prints the page's address and runs until Ctrl-C. Needs `pip install 'modpush[view]'`, no graphics card
and no Vulkan.
"""

import tyro

from modpush.viewer import PlayConfig, play

if __name__ == "__main__":
    play(tyro.cli(PlayConfig, description=__doc__))
