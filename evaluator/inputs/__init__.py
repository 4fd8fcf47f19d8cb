"""From the files of a command to what evaluations compute from."""
