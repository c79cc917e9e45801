"""`PlayConfig`: what the page starts with."""

from dataclasses import dataclass
from pathlib import Path

from modpush.envs.scenes.layouts import SCENES
from modpush.envs.scenes.objects import OBJECTS

__all__ = ["CONTROL_FREQ", "PlayConfig"]

CONTROL_FREQ = 15
"""Control steps per second of simulated time [Hz]."""


@dataclass(frozen=True, kw_only=True)
class PlayConfig:
    """What the page starts with; all but address and folders can be changed on the page."""

    policy: tuple[str, ...] = ("agent",)
    """One policy, or two that are shown side by side on the same scene: agent (the shipped one),
    corridor, corridor_faithful, scripted, hand, an agent's file, or a training run's folder."""
    scene: str = "slot"
    """Scene family that episodes are drawn from."""
    pushed_object: str = "small_cube"
    """Name of the pushed object."""
    difficulty: float = 0.3
    """Difficulty of the scenes, 0 to 1."""
    seed: int = 0
    """Seed of the first episode; in a replay, the number of the episode."""
    replay: tuple[Path, ...] = ()
    """One or two folders that an evaluation wrote, whose episodes are shown instead of running
    policies."""
    paused: bool = False
    """Start paused."""
    host: str = "127.0.0.1"
    """Address to listen on; the default is reached from this machine only. The page has no password:
    whoever reaches it can use it."""
    port: int = 8080
    """Port to listen on; if it is taken, the next free one is used and printed."""
    out: Path = Path("runs/play")
    """Folder that recorded videos are written to."""

    def __post_init__(self) -> None:
        """Check names and ranges."""
        for name, value, known in (
            ("scene", self.scene, SCENES),
            ("pushed_object", self.pushed_object, OBJECTS),
        ):
            if value not in known:
                raise ValueError(
                    f"PlayConfig: {name} must be one of {sorted(known)}, got {value!r}."
                )
        for name, count, least in (
            ("policy", len(self.policy), 1),
            ("replay", len(self.replay), 0),
        ):
            if not least <= count <= 2:
                raise ValueError(f"PlayConfig: {name} must name one or two, got {count}.")
        if not 0 <= self.difficulty <= 1:
            raise ValueError(f"PlayConfig: difficulty must be in [0, 1], got {self.difficulty}.")
        if not 0 <= self.port < 65536:
            raise ValueError(f"PlayConfig: port must be in [0, 65535], got {self.port}.")
