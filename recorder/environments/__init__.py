"""Python environments for simulators that cannot live together: made once, found by every run that needs one.

Each run is a process of its own, so it may as well be one of another Python. The command itself, and the evaluator,
never import an engine, and none of an engine's pins reaches them.
"""
