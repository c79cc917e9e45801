from .config import PlayConfig as PlayConfig
from .lane import Lane as Lane, PolicyLane as PolicyLane, Snapshot as Snapshot
from .page import Page as Page, play as play
from .policies import POLICIES as POLICIES
from .replay import ReplayLane as ReplayLane
from .session import Session as Session
