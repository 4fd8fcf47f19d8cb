"""What engines on JAX share."""
