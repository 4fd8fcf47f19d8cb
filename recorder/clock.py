"""The time of the calendar, as recordings hold it: nanoseconds since 1970 that fit their fields."""

from __future__ import annotations

import time

LAST_NS = 2**63 - 1
"""The largest time that a recording holds [ns]: a moment in 2262."""


def calendar_ns() -> int:
    """UTC since the Unix epoch [ns]; 0 where the machine's clock stands before it, LAST_NS behind what can be held."""
    return min(max(0, time.time_ns()), LAST_NS)


def problem() -> str:
    """What is wrong with the machine's clock, and what is recorded instead; empty where nothing is."""
    now = time.time_ns()
    if 0 <= now <= LAST_NS:
        return ""
    when, instead = ("before 1970", "1970-01-01T00:00:00Z") if now < 0 else ("behind 2262", "the last moment that fits")
    return (
        f"this machine's clock stands {when}: calendar times within the recording are {instead}; set the clock. "
        "No interval is measured by it"
    )
