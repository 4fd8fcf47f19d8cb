"""A scene and its states as messages that viewers draw: shapes once, poses over simulated time, events."""
