"""Pushed objects, layouts of obstacles, and the starts of episodes, as plain data."""
