"""Truncated quantile critics: networks, loss, update, and an agent from a config."""
