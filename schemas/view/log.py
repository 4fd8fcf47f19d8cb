"""Events of a run as lines of a log."""

from __future__ import annotations

from typing import Any

from gpusimbench.schemas.text import line
from gpusimbench.schemas.view import foxglove


def event_line(kind: str, phase: str, text: str, unix_ns: int) -> Any:
    """A Log of an event: its kind such as "PHASE_BEGIN", the phase, what is said, and its time of the calendar [ns]."""
    said = " ".join(filter(None, (kind.replace("_", " ").lower(), phase, text)))
    return foxglove.log("ERROR" if kind == "GATE" else "INFO", line(said), unix_ns)


def status_line(status: str, reason: str, unix_ns: int, *, good: bool) -> Any:
    """A Log of how a run ended: its status such as "complete", and why."""
    said = f"status {status}{': ' if reason else ''}{reason}"
    return foxglove.log("INFO" if good else "ERROR", line(said), unix_ns)
