"""gsb-compare --history: recordings of many versions or commits, and where a quantity changed."""
