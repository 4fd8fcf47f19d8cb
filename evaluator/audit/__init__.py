"""Recordings checked, run again here, and held against what came out."""
