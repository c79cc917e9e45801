"""The task in SAPIEN and ManiSkill."""
