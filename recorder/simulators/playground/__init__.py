"""MuJoCo Playground."""
