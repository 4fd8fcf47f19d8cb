"""Runs of a user's program, held against each other: gsb-run."""
