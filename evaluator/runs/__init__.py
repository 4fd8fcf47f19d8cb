"""What remains of a recording once its file is closed, and which runs belong together."""
