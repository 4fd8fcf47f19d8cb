"""The benchmark's metrics, one module each: pure functions on arrays, no reading of files."""
