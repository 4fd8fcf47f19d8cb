"""The version of the JSON of all commands."""

SCHEMA_VERSION = 2
"""It counts, from 1, the releases in which a key vanished or changed its meaning. The manifest of a data set has a
version of its own, since programs read manifests of other releases."""
