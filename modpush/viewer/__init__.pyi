from .config import PlayConfig as PlayConfig
from .lane import POLICIES as POLICIES, Lane as Lane, PolicyLane as PolicyLane, Snapshot as Snapshot
from .page import Page as Page, play as play
from .replay import ReplayLane as ReplayLane
from .session import Session as Session
