from .attentive import AttentiveSampler as AttentiveSampler
from .buffer import ReplayConfig as ReplayConfig
from .buffer import make_replay_buffer as make_replay_buffer
from .compact import CompactStorage as CompactStorage
from .similarity import (
    LatentSimilarity as LatentSimilarity,
)
from .similarity import (
    cosine as cosine,
)
from .similarity import (
    negative_l2 as negative_l2,
)
