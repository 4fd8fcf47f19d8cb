"""What recorder and evaluator need to be commands."""

from __future__ import annotations

SCHEMA_VERSION = 2
"""Of the JSON of all commands: it counts, from 1, the releases in which a key vanished or changed its meaning. The
manifest of a data set has a version of its own, since programs read manifests of other releases."""
