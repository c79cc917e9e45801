"""The boundary to physics engines, and the engines behind it."""
