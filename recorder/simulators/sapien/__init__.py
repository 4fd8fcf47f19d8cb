"""SAPIEN: PhysX through SAPIEN's own Python interface; and what ManiSkill, which is built on it, shares."""
