"""Replay: attentive sampling."""

from modpush.replay.attentive import AttentiveSampler
from modpush.replay.similarity import LatentSimilarity, cosine, negative_l2

__all__ = ["AttentiveSampler", "LatentSimilarity", "cosine", "negative_l2"]
