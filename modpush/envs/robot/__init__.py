"""The UR5 with its tools: shapes, kinematics and control. Needs no simulator."""
