"""Recordings that tests read."""

from __future__ import annotations

from pathlib import Path

from gpusimbench import open_recording, verify
from gpusimbench.evaluator.read.recording import Recording


def verified(path: str | Path) -> Recording:
    """A recording that is as it was written; DamagedRecording where it is not."""
    recording = open_recording(path)
    verify(recording)
    return recording
