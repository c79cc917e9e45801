from .attentive import (
    AttentiveSampler as AttentiveSampler,
    cosine as cosine,
    negative_l2 as negative_l2,
)
from .buffer import (
    TRANSITION_KEYS as TRANSITION_KEYS,
    KeepTransition as KeepTransition,
    make_replay_buffer as make_replay_buffer,
    update_priorities as update_priorities,
)
from .config import ReplayConfig as ReplayConfig
from .mirror import MirrorTransitions as MirrorTransitions
from .n_step import (
    NStepTransform as NStepTransform,
    extend_rollout as extend_rollout,
    forget_open_steps as forget_open_steps,
)
from .prioritized import PrioritizedSampler as PrioritizedSampler
