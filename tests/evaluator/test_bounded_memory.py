"""A set of recordings far larger than the memory that evaluating it may take."""

from __future__ import annotations

import os
import resource
import shutil
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.conftest import Command
from tests.synthetic import grid, write_recording

_LIMIT = 320 << 20
"""Of private memory. Half of it is Python, NumPy, SciPy and what they reserve before the first file is opened."""

_FILES, _ENVS, _STEPS = 12, 64, 3000


@pytest.fixture(scope="module")
def large_set(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """Recordings of moving cubes that together take more than twice the limit."""
    folder = tmp_path_factory.mktemp("large")
    noise = np.random.default_rng(0)

    def falling(start: NDArray[np.float32], step: int) -> NDArray[np.float32]:
        return start + np.float32(step * 1e-6)

    files = []
    for run in range(_FILES):
        final = grid(_ENVS, "float32") + noise.normal(size=(_ENVS, 27, 3)).astype(np.float32) * np.float32(1e-3)
        files.append(write_recording(folder, final, run=run, steps=_STEPS, dt=0.01, path_of=falling))
    assert sum(file.stat().st_size for file in files) > 2 * _LIMIT
    yield files
    shutil.rmtree(folder)


@pytest.mark.slow
def test_memory_is_bounded(large_set: list[Path], tmp_path: Path, gsb_eval: Command) -> None:
    """Verify and evaluate a set within a limit that its files exceed several times."""
    limited = {
        "preexec_fn": lambda: resource.setrlimit(resource.RLIMIT_DATA, (_LIMIT, _LIMIT)),
        # each thread of a library reserves a stack, and a machine with many cores would have many
        "env": {**os.environ, "OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1", "MALLOC_ARENA_MAX": "2"},
    }
    done = gsb_eval(
        *large_set, "--sample-time", 30, "--json", tmp_path / "out.json", "--html", tmp_path / "report", "--no-cache",
        **limited, code=0,
    )  # fmt: skip
    assert f"{_ENVS} envs, {_FILES} complete runs" in done.stdout
