"""Record massively parallel robot simulators, and evaluate the recordings offline."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from gpusimbench.evaluator.read.recording import Recording
    from gpusimbench.schemas.location import Place

__all__ = ["open_recording"]


def open_recording(path: str | Place) -> Recording:
    """Open a recording for reading; nothing but its index is read.

    path  of a file of this machine, or its address elsewhere: "s3://bucket/run.mcap", "https://..." (docs/remote.md)

    Raises NotARecording, DamagedRecording or Unreachable (see gpusimbench.schemas.errors).
    """
    from gpusimbench.evaluator.read.recording import Recording

    return Recording(path)
