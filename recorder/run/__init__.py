"""One run: its phases, in order, into one recording."""
