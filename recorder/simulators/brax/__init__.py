"""Brax."""
