"""Vector environments of others, recorded as they are stepped."""
