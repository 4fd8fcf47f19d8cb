"""Exact optimal transport (W1) between point sets: the distance behind every position metric."""
