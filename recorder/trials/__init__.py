"""Measured trials of the real world as recordings."""
