"""Isaac Lab, on PhysX (ovphysx, or Isaac Sim's) or on Newton."""
