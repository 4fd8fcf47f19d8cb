"""Offline evaluation: every metric from recordings alone, with no simulator, no GPU and no accelerator library.

from evaluator import open_recording

recording = open_recording("recordings/mujoco-inclined-collision-n16-r0-....mcap")
recording.state("cubes", "position")[-1]     # last recorded step, [env, item, 3]
"""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from evaluator.recording import Recording
    from schemas.location import Place

__all__ = ["open_recording"]


def open_recording(path: str | Place) -> Recording:
    """Open a recording for reading; nothing but its index is read.

    path  of a file of this machine, or its address elsewhere: "s3://bucket/run.mcap", "https://..." (docs/remote.md)

    Raises NotARecording, DamagedRecording or Unreachable (see schemas.errors).
    """
    from evaluator.recording import Recording

    return Recording(path)
