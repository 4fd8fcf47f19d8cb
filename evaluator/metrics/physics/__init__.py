"""What mechanics demands of a recorded motion, whatever engine made it."""
