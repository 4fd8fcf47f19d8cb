"""Recorders: a scene in N identical environments on a simulator, written to a recording. Knows no metric."""
