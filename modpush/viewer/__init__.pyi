from .config import PlayConfig as PlayConfig
from .lane import POLICIES as POLICIES, PolicyLane as PolicyLane, Snapshot as Snapshot
from .page import Page as Page, play as play
from .session import Session as Session
