"""Recordings in other shapes, for archives and viewers: what gsb-share does."""
