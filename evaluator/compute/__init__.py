"""Where computing happens: here, on the nodes of a cluster, or not at all, where the cache has the result."""
