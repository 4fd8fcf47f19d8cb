"""What an evaluation finds: metrics, their estimates for groups, sweeps, rankings; before any presentation."""
