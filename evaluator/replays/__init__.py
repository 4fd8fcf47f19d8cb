"""gsb-replay: episodes of a recording beside the same episodes, replayed."""
