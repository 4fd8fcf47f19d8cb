"""From runs to metrics, sweeps, a ranking and the price of determinism."""
