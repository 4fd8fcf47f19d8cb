"""The sections of a report, a topic a module: each is a function that returns its section, or None."""
