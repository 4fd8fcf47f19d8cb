"""Data sets of demonstrations, as recordings."""
