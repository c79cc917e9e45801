"""Robots and tools as data, their kinematics and control. Needs no simulator."""
