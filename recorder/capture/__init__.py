"""From a simulator's arrays to the bytes of a file."""
