"""From what the user asks to the runs that will be made, each with its file."""

from __future__ import annotations

import re
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

from schemas import PARTIAL
from schemas.configuration import OPTIONAL_PHASES, RunConfiguration
from schemas.errors import GsbError, UsageError

MAX_ENVS = 1 << 24


def check(configuration: RunConfiguration) -> None:
    """UsageError where the numbers cannot be."""
    c = configuration
    whole = {"--n-env": c.n_env, "--steps": c.steps, "--stride": c.stride}
    if "timed" in c.phases:
        whole["--timed-steps"] = c.timed_steps
    for name, value in whole.items():
        if value < 1:
            raise UsageError(f"{name} is at least 1, not {value}")
    if c.n_env > MAX_ENVS:
        raise UsageError(f"--n-env is at most {MAX_ENVS}, not {c.n_env}")
    if c.warmup < 0:
        raise UsageError(f"--warmup is at least 0, not {c.warmup}")
    if not 0 < c.dt <= 1:
        raise UsageError(f"--dt is a step in seconds, above 0 and at most 1, not {c.dt}")
    if c.steps % c.stride:
        raise UsageError(
            f"--stride {c.stride} does not divide --steps {c.steps}, so the last state would not be recorded"
        )
    unknown = set(c.phases) - set(OPTIONAL_PHASES)
    if unknown or not c.phases:
        raise UsageError(f"--phases takes {' and '.join(OPTIONAL_PHASES)}, comma separated, not '{','.join(c.phases)}'")


def runs(configuration: RunConfiguration, count: int) -> list[RunConfiguration]:
    """The same configuration for each run of a set; nothing else differs between them."""
    if count < 1:
        raise UsageError(f"--runs is at least 1, not {count}")
    return [replace(configuration, run_index=index) for index in range(count)]


def utc_now() -> str:
    """The present, UTC, ISO 8601 in seconds."""
    return datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ")


def recording_path(folder: Path, configuration: RunConfiguration, created: str) -> Path:
    """<sim>-<scene>-n<N>-r<run>-<UTC>.mcap, with a number appended where that name is taken."""
    c = configuration
    stamp = re.sub(r"[-:]", "", created)
    stem = f"{c.simulator}-{c.scene}-n{c.n_env}-r{c.run_index}-{stamp}"
    path = folder / f"{stem}.mcap"
    number = 2
    while path.exists() or path.with_name(path.name + PARTIAL).exists():
        path = folder / f"{stem}-{number}.mcap"
        number += 1
    return path


def prepare_folder(folder: Path) -> None:
    """Make the output folder, and see that it takes files."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        probe = folder / f".gsb-write-test-{datetime.now(UTC).timestamp()}"
        probe.touch(exist_ok=False)
        probe.unlink()
    except OSError as error:
        raise GsbError(f"cannot write to {folder}: {error.strerror}; choose another folder with --out") from None
