"""Both sides of a failed assertion as recordings, so that gsb-diff and gsb-info can look at all of them."""

from __future__ import annotations

import re
import shutil
from collections.abc import Mapping
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gpusimbench.evaluator.diff.arrays import Rows
from gpusimbench.evaluator.read.recording import Recording
from gpusimbench.recorder.log import RecordingWriter
from gpusimbench.recorder.vector.fields import NO_STEP, field_of, recorded_dtype
from gpusimbench.schemas import __version__
from gpusimbench.testing.assertions import Differs

_LONGEST = 150  # characters of a file's name
_STEP_S = 1.0  # time steps of environments are not known


def keep(failure: Differs, folder: Path, test: str) -> str:
    """Write both sides of a failure into a folder, which is made; returns what to say of it.

    test  node id of the test; the files are named after it, and never written over others

    Recordings are copied. Numbers of arrays that are neither float32 nor float64 are written in the one of the two that
    has them all, and whole numbers beyond 2^53 in the nearest; a note in the file says so.
    """
    if reason := _why_not(failure):
        return f"not kept: {reason}"
    folder.mkdir(parents=True, exist_ok=True)
    paths = _free(folder, re.sub(r"[^\w.-]+", "-", test).strip("-")[-_LONGEST:] or "test")
    for index, (path, side) in enumerate(zip(paths, failure.sides, strict=True)):
        if isinstance(side, Recording):
            shutil.copyfile(str(side.path), path)
        else:
            _write(path, side, test=test, index=index)
    return f"kept: gsb-diff {paths[0]} {paths[1]}"


def _why_not(failure: Differs) -> str:
    for name, side in zip(failure.names, failure.sides, strict=True):
        if isinstance(side, Recording):
            if not isinstance(side.path, Path):
                return f"{side.path} is no file of this machine"
            continue
        ends = {rows.steps.stop for rows in side.values()}
        if len(ends) > 1 or ends < {2} or len({rows.values.shape[1] for rows in side.values()}) > 1:
            return (
                f"the arrays of {name} are not of one number of environments and steps, of which there are two or more"
            )
    return ""


def _free(folder: Path, name: str) -> tuple[Path, Path]:
    for number in count(1):
        stem = name if number == 1 else f"{name}-{number}"
        paths = folder / f"{stem}-a.mcap", folder / f"{stem}-b.mcap"
        if not any(path.exists() for path in paths):
            return paths
    raise AssertionError  # there is always another number


def _write(path: Path, side: Mapping[str, Rows], *, test: str, index: int) -> None:
    recorded = [_recorded(rows) for rows in side.values()]
    fields = [
        field_of(name, rows.values.dtype, rows.values.shape[2:], *([NO_STEP] if rows.first else []))
        for name, rows in side.items()
    ]
    steps, n_env = recorded[0].shape[:2]
    with RecordingWriter(
        path, simulator="gpusimbench.testing", version=__version__, scene=test, n_env=n_env, dt=_STEP_S,
        steps=steps - 1, fields=fields, run_index=index, view=(),
        options={"dt": "not known; a step counts as 1 s"},
    ) as log:  # fmt: skip
        log.append(*recorded)


def _recorded(rows: Rows) -> NDArray[Any]:
    """[step, env, ...] from step 0 on."""
    values = rows.values.astype(recorded_dtype(rows.values.dtype))
    return np.concatenate([np.zeros((rows.first, *values.shape[1:]), dtype=values.dtype), values])
