"""gsb-record: its arguments, what it does with them, and what it prints."""
