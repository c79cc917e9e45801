"""An object of your own: an L-shaped profile made of two boxes.

    python examples/extending/pushed_object.py

Contract: upright convex solids. `centered` moves them into the object's frame, whose origin is in the
middle of the height over the centroid. Radius, height and symmetry are computed from them.
"""

import tempfile
from pathlib import Path

from modpush import Trainer, load_agent
from modpush.envs import PushedObject
from modpush.geometry import box, centered
from modpush.training import TRAIN_PRESETS

PROFILE = PushedObject(
    name="l_profile",
    parts=centered(
        box(0.08, 0.03, 0.04),
        box(0.03, 0.05, 0.04, position=(-0.025, 0.04, 0.0)),
    ),
    mass=0.5,
)


def main(folder: Path) -> dict[str, float]:
    """Train a few steps with the object; returns what was computed of it, and what was observed."""
    config = TRAIN_PRESETS["smoke"]
    parts = {"pushed_object": PROFILE}
    Trainer(config, folder, parts=parts).run()
    env = load_agent(folder / "last_agent.safetensors", parts=parts).make_env(num_envs=1, seed=0)
    observed = env.reset()
    env.close()
    return {
        "radius": PROFILE.radius,
        "symmetry": PROFILE.symmetry,
        "observed_radius": observed["object_radius"].item(),
        "observed_symmetry": observed["object_symmetry"].item(),
    }


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as folder:
        print(main(Path(folder) / "run"))
