"""A ranking of simulators that follows from recordings, and from nothing else."""
