"""Replay: attentive sampling, compact storage, buffers from a config."""

from modpush.replay.attentive import AttentiveSampler
from modpush.replay.buffer import ReplayConfig, make_replay_buffer
from modpush.replay.compact import CompactStorage
from modpush.replay.similarity import LatentSimilarity, cosine, negative_l2

__all__ = [
    "AttentiveSampler",
    "CompactStorage",
    "LatentSimilarity",
    "ReplayConfig",
    "cosine",
    "make_replay_buffer",
    "negative_l2",
]
