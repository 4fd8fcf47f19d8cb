"""A recording as arrays, read on demand."""
