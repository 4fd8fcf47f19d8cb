"""Sets of runs: equal ones, sweeps, replays, and what of them is there already."""
