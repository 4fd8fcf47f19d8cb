"""PhysX, NVIDIA's rigid-body engine, through ovphysx."""
