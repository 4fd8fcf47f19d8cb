"""A sweep's lock on its folder: one command at a time makes the runs of a sweep there.

Two sweeps have one lock where recordings of one would count for the other (recorder.sets.finished.matching); other
sweeps, and sets of runs, may share the folder.
"""

from __future__ import annotations

import hashlib
import json
from contextlib import AbstractContextManager
from pathlib import Path

from gpusimbench.recorder.sets.finished import in_common
from gpusimbench.schemas.configuration import RunConfiguration
from gpusimbench.schemas.folder_lock import held


def locked(folder: Path, wanted: RunConfiguration, where: str) -> AbstractContextManager[None]:
    """Hold the lock of a sweep of `wanted`, made `where` (recorder.sets.finished.where_am_i), while the block runs.

    GsbError where another process holds it, which the message names.
    """
    return held(folder, f"gsb-sweep-{_key(wanted, where)}", "makes this sweep")


def _key(wanted: RunConfiguration, where: str) -> str:
    text = json.dumps([in_common(wanted).to_json(), where], sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()[:16]
