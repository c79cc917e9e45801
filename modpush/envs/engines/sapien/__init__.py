"""SAPIEN behind the boundary `Engine`, and the ManiSkill task that builds its scenes."""
