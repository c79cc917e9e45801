"""Compiled searches and maps that the planners share."""
