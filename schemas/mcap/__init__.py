"""MCAP files (https://mcap.dev/spec): one walk over records and chunks, a reader, and a writer."""
