"""Environments whose arrays live on a device: rows stay there, and come to the host a block at a time."""
