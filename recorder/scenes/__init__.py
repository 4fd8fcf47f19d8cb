"""What is simulated, described without reference to any engine."""
