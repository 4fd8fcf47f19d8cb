"""ManiSkill."""
