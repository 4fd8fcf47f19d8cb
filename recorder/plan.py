"""From what the user asks to the runs that will be made, each with its file."""

from __future__ import annotations

import re
import shutil
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

from gpusimbench.recorder.abilities import listed
from gpusimbench.recorder.scenes.base import Scene
from gpusimbench.schemas import PARTIAL
from gpusimbench.schemas.configuration import CAPTURE_MODES, MAX_ENVS, MAX_VIEW, OPTIONAL_PHASES, RunConfiguration
from gpusimbench.schemas.errors import DataLost, GsbError, UsageError
from gpusimbench.schemas.text import did_you_mean
from gpusimbench.schemas.treatment import KINDS, MOST_METRES, Intervention, Keep
from gpusimbench.schemas.writing import Taken, create, give_name

MIN_DT = 1e-6
"""Shortest step [s]: times are recorded in whole nanoseconds, and a step is to be off by no more than a thousandth."""

MAX_SNAPSHOTS = 64
"""Snapshots that a run takes."""

MAX_TIMEOUT = 1e9
"""Longest time limit [s]."""


def option(name: str) -> str:
    """What the command line calls an argument."""
    return f"--{name.replace('_', '-')}"


def check_dt(dt: float, name: str = "--dt") -> None:
    """UsageError where no step [s] is that short or long; `name` is what the caller has it by."""
    if not MIN_DT <= dt <= 1:
        raise UsageError(
            f"{name} is a step in seconds, at least {MIN_DT:g} (times are recorded in whole nanoseconds) and at "
            f"most 1, not {dt:g}"
        )


def check(configuration: RunConfiguration, named: Callable[[str], str] = option) -> None:
    """UsageError where the numbers cannot be.

    named  what the caller calls the argument n_env, steps, ...; the option of the command line
    """
    c = configuration
    whole = {"n_env": c.n_env, "steps": c.steps, "stride": c.stride}
    if "timed" in c.phases:
        whole["timed_steps"] = c.timed_steps
    for name, value in whole.items():
        if value < 1:
            raise UsageError(f"{named(name)} is at least 1, not {value}")
    if c.n_env > MAX_ENVS:
        raise UsageError(f"{named('n_env')} is at most {MAX_ENVS}, not {c.n_env}")
    if c.warmup < 0:
        raise UsageError(f"{named('warmup')} is at least 0, not {c.warmup}")
    check_dt(c.dt, named("dt"))
    if not 0 <= c.timeout <= MAX_TIMEOUT:
        raise UsageError(f"--timeout is a number of seconds up to {MAX_TIMEOUT:g}, 0 for never, not {c.timeout:g}")
    if c.steps % c.stride:
        raise UsageError(
            f"{named('stride')} {c.stride} does not divide {named('steps')} {c.steps}, so the last state would not be "
            "recorded"
        )
    if c.intervention and Intervention.parse(c.intervention).step >= c.steps:
        raise UsageError(f"--intervene {c.intervention} comes after a step below --steps, {c.steps}")
    if len(c.snapshots) > MAX_SNAPSHOTS or not all(c.first_step <= step <= c.steps for step in c.snapshots):
        raise _no_snapshots(c.first_step, c.steps, _listed(c.snapshots))
    if c.capture not in CAPTURE_MODES:
        raise UsageError(f"--capture is {' or '.join(CAPTURE_MODES)}, not '{c.capture}'")
    if len(c.view) > MAX_VIEW or len(set(c.view)) < len(c.view):
        raise UsageError(f"{named('view_env')} names at most {MAX_VIEW} environments, each once, not {_listed(c.view)}")
    if not all(0 <= env < c.n_env for env in c.view):
        raise UsageError(
            f"{named('view_env')} is from 0 to {c.n_env - 1}, as {named('n_env')} is {c.n_env}, not {_listed(c.view)}"
        )
    if "import" in c.phases and not c.model:
        raise UsageError("--phases import is of a model file: --model FILE")
    unknown = set(c.phases) - set(OPTIONAL_PHASES)
    if unknown or not c.phases or len(set(c.phases)) < len(c.phases):
        raise UsageError(
            f"--phases takes {listed(OPTIONAL_PHASES)}, comma separated, each at most once, "
            f"not '{','.join(c.phases)}'{did_you_mean(min(unknown), OPTIONAL_PHASES) if unknown else ''}"
        )


def view_of(envs: Sequence[int], *, off: bool, phases: Sequence[str], keep: str = "") -> tuple[int, ...]:
    """Environments that a recording has a view of: those asked for, or the first, where all states are captured.

    off   none is wanted
    keep  as of a RunConfiguration

    UsageError for an answer that contradicts another.
    """
    captured = "capture" in phases
    if envs and off:
        raise UsageError("--view-env names environments for the view that --no-view leaves out; give one of them")
    if envs and not captured:
        raise UsageError("--view-env is of captured states, and --phases has no capture")
    return () if off or not captured else tuple(envs) or (() if keep else (0,))


def _listed(numbers: tuple[int, ...]) -> str:
    return ", ".join(map(str, numbers))


def check_runs(count: int) -> None:
    """UsageError where no set has so many runs."""
    if count < 1:
        raise UsageError(f"--runs is at least 1, not {count}")


def parse_snapshots(text: str, steps: int) -> tuple[int, ...]:
    """Steps that --snapshot names, ascending. UsageError where they are no numbers; `check` holds their bounds."""
    found = [word.strip() for word in text.split(",")] if text else []
    if not all(word.isdecimal() for word in found):
        raise _no_snapshots(0, steps, text)
    return tuple(sorted({int(word) for word in found}))


def _no_snapshots(first: int, last: int, asked: str) -> UsageError:
    return UsageError(
        f"--snapshot is a list of captured steps, from {first} to --steps ({last}), separated by commas, at most "
        f"{MAX_SNAPSHOTS}, not '{asked}'"
    )


def runs(configuration: RunConfiguration, count: int) -> list[RunConfiguration]:
    """The same configuration for each run of a set; nothing else differs between them."""
    return [replace(configuration, run_index=index) for index in range(count)]


def utc_now() -> str:
    """The present, UTC, ISO 8601 in seconds."""
    return datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ")


def reserve(folder: Path, configuration: RunConfiguration, created: str) -> Path:
    """<sim>[-<impl, backend, solver>][-<determinism>]-<scene>-n<N>-r<run>-<UTC>.mcap, and a number where that is taken.

    The name is taken by making its .partial file, empty, so that no other recorder gets it. GsbError where the folder
    does not take files.
    """
    c = configuration
    stamp = re.sub(r"[-:]", "", created)
    chosen = [c.options[name] for name in ("impl", "backend", "solver") if name in c.options]
    level = [] if c.determinism == "default" else [c.determinism]
    who = "-".join(re.sub(r"[^A-Za-z0-9.]+", "-", word) for word in (c.simulator, *chosen, *level))
    stem = f"{who}-{c.scene}-n{c.n_env}-r{c.run_index}-{stamp}"
    path = folder / f"{stem}.mcap"
    number = 1
    while not _take(path):
        number += 1
        path = folder / f"{stem}-{number}.mcap"
    return path


def partial_of(path: Path) -> Path:
    """Where a recording is written until it is whole."""
    return path.with_name(path.name + PARTIAL)


def publish(path: Path) -> None:
    """Give a whole .partial file its final name, and flush the folder.

    DataLost where a file of that name appeared meanwhile; OSError where the disk says so.
    """
    partial = partial_of(path)
    try:
        give_name(partial, path)
    except Taken:
        raise DataLost(f"{path} appeared meanwhile; this run is in {partial}") from None


def release(path: Path) -> Path | None:
    """The .partial file of a reserved name; None, and the file removed, where nothing was written to it."""
    partial = partial_of(path)
    try:
        if partial.stat().st_size:
            return partial
        partial.unlink()
    except FileNotFoundError:
        pass
    return None


def prepare_folder(folder: Path) -> None:
    """Make the output folder, and see that it takes files."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        raise _unwritable(folder, error) from None


def free_bytes(folder: Path) -> int | None:
    """Free on the disk of a folder that may not be there yet [bytes]; None where that cannot be told."""
    for there in (folder.absolute(), *folder.absolute().parents):
        if there.exists():
            try:
                return shutil.disk_usage(there).free
            except OSError:
                return None
    return None


def _take(path: Path) -> bool:
    partial = partial_of(path)
    try:
        create(partial).close()
    except FileExistsError:
        return False
    except OSError as error:
        raise _unwritable(path.parent, error) from None
    # Looked for only now: a recorder that is just ending gives a file its name before it gives up the .partial.
    if path.exists():
        partial.unlink(missing_ok=True)  # that recorder may remove it as its own (release)
        return False
    return True


def _unwritable(folder: Path, error: OSError) -> GsbError:
    return GsbError(f"cannot write to {folder}: {error.strerror}; choose another folder with --out")


def parse_keep(text: str) -> str:
    """What --keep was given, as the recording keeps it. UsageError where it is nothing that can be kept."""
    try:
        return str(Keep.parse(text))
    except ValueError:
        raise UsageError(
            "--keep is failing or failing,within:METRES, with a distance above 0 and at most "
            f"{MOST_METRES:g} m, not '{text}'"
        ) from None


def check_keep(configuration: RunConfiguration, scene: Scene) -> None:
    """UsageError where a run that keeps failing environments alone cannot do what else is asked."""
    c = configuration
    if not c.keep:
        return
    whose = f"--keep {c.keep}"
    if "capture" not in c.phases:
        raise UsageError(f"{whose} is of captured states, and --phases has no capture")
    if c.stride != 1:
        raise UsageError(f"{whose} keeps every step before a failure; leave --stride out")
    if c.capture != CAPTURE_MODES[0]:
        raise UsageError(f"{whose} writes little, when an environment fails; leave --capture {c.capture} out")
    if c.view:
        raise UsageError(f"{whose} writes no states while nothing fails, so viewers have none; leave --view-env out")
    if c.snapshots or c.first_step:
        raise UsageError(f"{whose} goes together with neither --snapshot nor --from")
    intervention = Intervention.of(c.intervention)
    if intervention and not intervention.kind.poisons:
        alone = " or ".join(kind.form for kind in KINDS.values() if kind.poisons)
        raise UsageError(f"{whose} goes together with --intervene {alone} alone, not with {c.intervention}")
    if Keep.parse(c.keep).within is not None and not scene.groups():
        raise UsageError(
            f"{whose}: scene '{scene.name}' has no free bodies, whose positions could leave bounds; use --keep failing"
        )
