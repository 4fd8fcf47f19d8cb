"""Two sets of recordings, base and head: what differs, whether it is worse, and how sure that is."""
