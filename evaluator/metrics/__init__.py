"""The benchmark's metrics, a topic a module: pure functions on arrays, no reading of files."""
