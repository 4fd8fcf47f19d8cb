"""gsb-record --sim real: measured trials of a CSV file, or measured motions of scene cube-toss, as a recording, so that
nothing that compares it with simulations needs a special case.

A trial takes the place of an environment. The recording has one step of one sample time, and no state at step 0: what
was not measured is not there.
"""

from __future__ import annotations

import csv
import io
import json
import math
import uuid
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gpusimbench.recorder.capture.sink import Sink
from gpusimbench.recorder.plan import MIN_DT, prepare_folder, release, reserve, utc_now
from gpusimbench.recorder.probes.host import describe_software
from gpusimbench.recorder.scenes.base import Scene
from gpusimbench.recorder.sets.progress import say
from gpusimbench.recorder.trials.tosses import VARIABLE, read_tosses
from gpusimbench.schemas import topics
from gpusimbench.schemas.block_parts import state_parts
from gpusimbench.schemas.configuration import RunConfiguration, sim_time_ns
from gpusimbench.schemas.errors import DataLost, UsageError
from gpusimbench.schemas.fields import FIELD_KINDS, StateField, body_fields
from gpusimbench.schemas.provenance import PROVENANCE, REAL, SCENE, SIMULATION, TRIALS, Provenance, Simulation
from gpusimbench.schemas.tosses import GROUP, TOSSES
from gpusimbench.schemas.trial_units import METRES, extent_of, unit_doubt

_GROUP = "cubes"
SAMPLE_TIME = 5.0
"""At which trials were measured, unless the user says otherwise [s]."""

COLUMNS = ("trial", "cube", "x", "y")
HEIGHT = "z"
UNITS = {unit: METRES[unit] for unit in ("m", "cm")}
_BLOCK = 50  # rows of a message, the most that the format allows
_NOTES = {
    "linear_velocity": "as measured: the mean over the interval before the row, smoothed by its authors",
    "angular_velocity": "measured in the body's frame",
}


@dataclass(frozen=True)
class Destination:
    """Where and how trials are recorded.

    out   folder
    argv  the user's command
    """

    out: Path
    compression: str
    argv: tuple[str, ...]


def record_trials(
    scene: Scene, path: Path, destination: Destination, *, unit: str, sample_time: float = SAMPLE_TIME
) -> Path:
    """Write one recording from a CSV file; returns its path. Nothing is written unless every row is good.

    unit         of the positions in the file, of UNITS
    sample_time  at which they were measured [s]

    UsageError where the file or the scene has no such trials.
    """
    if not MIN_DT <= sample_time < float("inf"):
        raise UsageError(f"--sample-time is a time in seconds, at least {MIN_DT:g}, not {sample_time}")
    try:
        data = path.read_bytes()
        text = data.decode("utf-8")
    except OSError as error:
        raise UsageError(f"cannot read {path}: {error.strerror}") from None
    except UnicodeDecodeError:
        raise UsageError(f"{path} is not a text file in UTF-8") from None
    cubes = scene.groups().get(_GROUP, ())
    if not cubes:
        raise UsageError(f"scene {scene.name} has no {_GROUP} to measure")
    try:
        trials = parse_trials(text, unit=unit, cubes=len(cubes))
    except UsageError as error:
        raise UsageError(f"{path}: {error}") from None

    extent = extent_of(json.loads(scene.to_json()), _GROUP)
    doubt = unit_doubt(trials.positions, unit, trials.names, extent) if extent else None
    if doubt and doubt.wrong:
        raise UsageError(f"{path}: {doubt.text}")
    if doubt:
        say(f"gsb-record: warning: {path}: {doubt.text}")

    configuration = RunConfiguration(
        simulator=REAL,
        scene=scene.name,
        n_env=len(trials.names),
        dt=sample_time,
        steps=1,
        warmup=0,
        timed_steps=0,
        phases=("capture",),
        compression=destination.compression,
        options={"unit": unit},
    )
    kind = FIELD_KINDS["position"]
    field = StateField(
        _GROUP, "position", "float64", cubes, trials.components, kind.unit, "env",
        note="measured; step 1 is the time of the measurement",
    )  # fmt: skip
    options = {"unit": unit, "trials": list(trials.names)}
    simulation = _measured(scene, (field,), "each trial was set up anew", options=options, parameters={})
    with _new_recording(destination, configuration, scene, simulation) as sink:
        sink.attach(TRIALS, "text/csv", data)
        _write_field(sink, configuration, field, trials.positions[np.newaxis], first_step=1)
        sink.finish("COMPLETE", "", last_step=1, peak_rss_bytes=0)
    say(f"{len(trials.names)} trials of {len(cubes)} cubes")
    return sink.path


@dataclass(frozen=True)
class Trials:
    """Measured positions.

    names       of the trials, in order of appearance
    positions   [m], shape [trial, cube, 2 or 3]
    components  ("x", "y") or ("x", "y", "z")
    """

    names: tuple[str, ...]
    positions: NDArray[np.float64]
    components: tuple[str, ...]


def parse_trials(text: str, *, unit: str, cubes: int) -> Trials:
    """Trials from CSV text with the header trial,cube,x,y[,z]; further columns are not allowed.

    unit   of x, y and z: a key of UNITS
    cubes  number of cubes in each trial, numbered from 0

    Raises UsageError naming row (the header is row 1) and column of the first thing that is wrong.
    """
    try:
        rows = list(csv.reader(io.StringIO(text.removeprefix("\ufeff"), newline=None)))
    except csv.Error as error:
        raise UsageError(f"not readable as CSV: {error}") from None
    while rows and not any(cell.strip() for cell in rows[-1]):
        rows.pop()
    if not rows:
        raise UsageError("the trials file is empty; its first row is trial,cube,x,y or trial,cube,x,y,z")
    columns = [cell.strip() for cell in rows[0]]
    components = _components(columns)
    place = {name: columns.index(name) for name in (*COLUMNS[:2], *components)}
    found: dict[str, dict[int, tuple[float, ...]]] = {}
    first_row: dict[tuple[str, int], int] = {}
    for number, row in enumerate(rows[1:], start=2):
        if len(row) != len(columns):
            raise UsageError(f"row {number} has {len(row)} cells, the header has {len(columns)}")
        trial = row[place["trial"]].strip()
        if not trial:
            raise UsageError(f"row {number}, column trial: empty")
        cube = _cube(row[place["cube"]], number, cubes)
        if (trial, cube) in first_row:
            raise UsageError(
                f"row {number}, column cube: trial {trial} has cube {cube} already, in row {first_row[trial, cube]}"
            )
        first_row[trial, cube] = number
        point = tuple(_number(row[place[name]], number, name) * UNITS[unit] for name in components)
        found.setdefault(trial, {})[cube] = point
    if not found:
        raise UsageError("the trials file has a header and no rows")
    for trial, points in found.items():
        missing = sorted(set(range(cubes)) - set(points))
        if missing:
            last = max(row for (name, _), row in first_row.items() if name == trial)
            raise UsageError(
                f"trial {trial} (last in row {last}), column cube: {len(points)} of {cubes} cubes; "
                f"missing: {', '.join(map(str, missing))}"
            )
    positions = np.array([[points[c] for c in range(cubes)] for points in found.values()])
    return Trials(tuple(found), positions, components)


def _components(columns: list[str]) -> tuple[str, ...]:
    for name in COLUMNS:
        if name not in columns:
            raise UsageError(
                f"row 1: column {name} is missing; the header is trial,cube,x,y or trial,cube,x,y,z; positions or "
                "joint angles over time: see docs/how-to/real-trials.md"
            )
    for name in columns:
        if name not in (*COLUMNS, HEIGHT):
            raise UsageError(f"row 1: column '{name}' is not known; the header is trial,cube,x,y or trial,cube,x,y,z")
        if columns.count(name) > 1:
            raise UsageError(f"row 1: column {name} appears twice")
    return ("x", "y", "z") if HEIGHT in columns else ("x", "y")


def _cube(cell: str, row: int, cubes: int) -> int:
    try:
        cube = int(cell)
    except ValueError:
        raise UsageError(f"row {row}, column cube: '{cell}' is not a whole number") from None
    if not 0 <= cube < cubes:
        raise UsageError(f"row {row}, column cube: {cube} is not one of the scene's {cubes} cubes, 0 to {cubes - 1}")
    return cube


def _number(cell: str, row: int, column: str) -> float:
    try:
        value = float(cell)
    except ValueError:
        raise UsageError(f"row {row}, column {column}: '{cell}' is not a number") from None
    if not math.isfinite(value):
        raise UsageError(f"row {row}, column {column}: {cell.strip()} is not a position")
    return value


def record_tosses(scene: Scene, path: Path | None, destination: Destination) -> Path:
    """Write the recording of a set of tosses; returns its path.

    path  of the set; None: as of read_tosses
    """
    tosses = read_tosses(path)
    configuration = RunConfiguration(
        simulator=REAL,
        scene=scene.name,
        n_env=len(tosses),
        dt=scene.dt,
        steps=tosses.steps(scene),
        warmup=0,
        timed_steps=0,
        phases=("capture",),
        compression=destination.compression,
    )
    fields = body_fields({GROUP: scene.groups()[GROUP]}, "float64", _NOTES)
    simulation = _measured(scene, fields, "each toss was thrown anew", options={}, parameters=scene.parameters)
    with _new_recording(destination, configuration, scene, simulation) as sink:
        sink.attach(TOSSES, "application/json", tosses.known.to_json().encode())
        if tosses.notice:
            sink.attach("LICENSE", "text/plain", tosses.notice.encode())
        rows = tosses.fields()
        for field in fields:
            _write_field(
                sink, configuration, field,
                tosses.side_by_side(rows[field.field], configuration.steps)[:, :, np.newaxis],
            )  # fmt: skip
        sink.finish("COMPLETE", "", last_step=configuration.steps, peak_rss_bytes=0)
    say(f"{len(tosses)} tosses: {tosses.known.source}")
    if not tosses.synthetic and not tosses.notice:
        say("no LICENSE lies beside the tosses: it has to travel with every copy of the data, this recording too")
    if tosses.synthetic and path is None:
        say(f"these are not measured; --tosses PATH, or {VARIABLE}, names the measured set (docs/how-to/cube-toss.md)")
    return sink.path


def _measured(
    scene: Scene, fields: tuple[StateField, ...], fresh_start: str, *, options: dict[str, Any],
    parameters: Mapping[str, Any],
) -> Simulation:  # fmt: skip
    return Simulation(
        version="measured",
        device="real",
        options=options,
        switches={},
        deviations=(),
        fields=fields,
        scene={"name": scene.name, "sha256": scene.sha256(), "parameters": parameters},
        fresh_start=fresh_start,
    )


@contextmanager
def _new_recording(
    destination: Destination, configuration: RunConfiguration, scene: Scene, simulation: Simulation
) -> Iterator[Sink]:
    """A recording of trials that is being written; on an error nothing remains, but for data that was lost."""
    prepare_folder(destination.out)
    created = utc_now()
    provenance = Provenance(str(uuid.uuid4()), created, destination.argv, configuration, software=describe_software())
    path = reserve(destination.out, configuration, created)
    try:
        sink = Sink(path, compression=configuration.compression, reserved=True)
        try:
            for name, said in ((PROVENANCE, provenance), (SCENE, scene), (SIMULATION, simulation)):
                sink.attach(name, "application/json", said.to_json().encode())
            yield sink
        except BaseException as error:
            sink.abandon()
            if not isinstance(error, DataLost):
                sink.partial.unlink(missing_ok=True)
            raise
    finally:
        release(path)


def _write_field(
    sink: Sink, configuration: RunConfiguration, field: StateField, rows: NDArray[np.float64], *, first_step: int = 0
) -> None:
    topic = topics.state(field.group, field.field, 0)
    sink.channel(topic, "gsb.v1.StateBlock", field.to_metadata())
    for row in range(0, len(rows), _BLOCK):
        block, first = np.ascontiguousarray(rows[row : row + _BLOCK]), first_step + row
        time = sim_time_ns(first, configuration.dt)
        sink.digest.state(field, configuration.n_env, block)
        sink.write_parts(
            topic, state_parts(block, first_step=first, stride=1, env_start=0, sim_time_ns=time), sim_ns=time
        )
