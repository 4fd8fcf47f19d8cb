"""Loops that step an engine on the work of a recording, and do nothing else: one module an engine, named like it."""
