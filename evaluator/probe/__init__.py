"""gsb-probe: whether a result depends on what should not matter, asked of recordings that differ in that alone."""
