"""What a recording is: messages, topics, units, provenance. No simulator and no metric lives here."""

FORMAT = "gsb.v1"
"""Name of the format, also the MCAP profile and the package of every message."""

GENERATED = f"{FORMAT}.1"
"""The MCAP profile of files with actions that a generator makes again: readers that cannot refuse it by its name."""

PROFILES = (FORMAT, GENERATED)
"""Of recordings that this version reads."""

PARTIAL = ".partial"
"""Ending of a recording that is being written, or that a crash left behind."""

__version__ = "0.1.0"
