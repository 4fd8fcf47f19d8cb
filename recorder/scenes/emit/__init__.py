"""Translations of a scene into the languages that engines read."""
