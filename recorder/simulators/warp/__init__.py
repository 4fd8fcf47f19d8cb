"""MuJoCo Warp; and what engines on Warp share."""
