"""How values become text, pictures and pages: the only place that escapes what a stranger wrote."""
