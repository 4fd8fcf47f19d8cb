"""Programs of users, run in fresh processes, whose recordings lie in a folder of each run."""
