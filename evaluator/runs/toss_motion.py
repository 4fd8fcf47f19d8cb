"""Tosses out of recordings: the measured ones of a reference, and which of them each simulated environment repeats."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from gpusimbench.evaluator.metrics.tosses import (
    Cube,
    LocalErrors,
    Motion,
    TossErrors,
    TrackingFloor,
    local_errors,
    toss_errors,
    tracking_floor,
)
from gpusimbench.evaluator.missing import Missing
from gpusimbench.evaluator.read.recording import Recording
from gpusimbench.evaluator.runs.positions import in_env_frame
from gpusimbench.schemas import arrays, checks
from gpusimbench.schemas.configuration import RunConfiguration
from gpusimbench.schemas.errors import DamagedRecording
from gpusimbench.schemas.initial import GIVEN
from gpusimbench.schemas.text import ordinal, plural
from gpusimbench.schemas.tosses import GROUP, ODD, TOSSES, TossSet, judged_on
from gpusimbench.schemas.treatment import TEACHER, Intervention

_ALIKE = 1e-4  # of two first states [m, and of quaternions]: float32 far from the origin rounds to 8e-6 m
_PARTS = ("position", "orientation", "linear_velocity", "angular_velocity")  # of a Motion, in its order
_WIDTHS = {"position": 3, "orientation": 4, "linear_velocity": 3, "angular_velocity": 3}
_HALF_STEP = 0.5  # gravity's share in a velocity that is a mean over the interval before


@dataclass(frozen=True)
class MeasuredTosses:
    """The tosses of a recording of real trials.

    known   what the set is
    motion  all rows; a toss that ended keeps its last row
    cube    that was thrown
    dt      time between rows [s]
    floor   that no simulation can go below
    """

    known: TossSet
    motion: Motion
    cube: Cube
    dt: float
    floor: TrackingFloor

    @property
    def counts(self) -> NDArray[np.int64]:
        """Measured rows of each toss."""
        return np.array(self.known.rows)

    def name(self) -> str:
        """For tables and sentences."""
        return f"{plural(len(self.known.rows), 'toss', 'tosses')}: {self.known.source}"


def measured_tosses(recording: Recording) -> MeasuredTosses | None:
    """The tosses that a recording has; None where it has none. DamagedRecording where it contradicts itself."""
    data = recording.attachment(TOSSES)
    if data is None:
        return None
    c = recording.configuration
    known = TossSet.from_json(data, c.n_env)
    motion = _motion(recording, np.arange(c.steps + 1))
    if isinstance(motion, Missing):
        raise DamagedRecording(f"{recording.path}: {motion.reason}")
    if not all(np.isfinite(getattr(motion, name)).all() for name in _PARTS):
        raise DamagedRecording(f"{recording.path}: its tosses are not all finite")
    if max(known.rows) > len(motion.rows):
        raise DamagedRecording(
            f"{recording.path}: {TOSSES} has a toss of {max(known.rows)} rows, more than are recorded"
        )
    cube = _cube(recording)
    first = motion.linear_velocity[0] - np.array([0.0, 0.0, cube.gravity * c.dt * _HALF_STEP])
    floor = tracking_floor(motion, np.array(known.rows), cube, c.dt, first)
    return MeasuredTosses(known, motion, cube, c.dt, floor)


def errors_of(recording: Recording, measured: MeasuredTosses, only: str = "") -> TossErrors | Missing:
    """Errors of a simulation of measured tosses, in the order of the tosses.

    Of a toss that several environments repeat, those of the first; of a run whose options were fitted on even tosses,
    those of odd ones. The reason where they cannot be computed.

    only  EVEN or ODD, instead of the tosses that it is judged by
    """
    if settings := set_every(recording.configuration):
        return Missing(f"it is set to the tosses every {plural(settings, 'step')}: it has local errors")
    found = _simulated(recording, measured, 1, only)
    if isinstance(found, Missing):
        return found
    motion, tosses, _ = found
    errors = toss_errors(motion, _of_envs(measured.motion, tosses), measured.counts[tosses], measured.cube, measured.dt)
    return replace(errors, numbers=tosses)


def local_errors_of(recording: Recording, measured: MeasuredTosses) -> LocalErrors | Missing:
    """Errors after each setting to a measured state, of a recording with --intervene teacher@STEPS, in the order of
    the tosses; the reason where they cannot be computed."""
    settings = set_every(recording.configuration)
    if not settings:
        return Missing("it is not set to the tosses on the way: record with --intervene teacher@STEPS")
    found = _simulated(recording, measured, settings)
    if isinstance(found, Missing):
        return found
    motion, tosses, envs = found
    rows, counts = int(motion.rows[0]), measured.counts[tosses]
    if rows >= counts.max():
        return Missing(f"it is set after {rows} rows, and the longest toss has {counts.max()}")
    if wrong := _wrongly_set(recording, _of_envs(measured.motion, tosses), counts, envs, rows):
        return Missing(wrong)
    return local_errors(motion, _of_envs(measured.motion, tosses), counts, measured.cube, measured.dt, rows)


def _wrongly_set(
    recording: Recording, measured: Motion, counts: NDArray[np.int64], envs: NDArray[np.int64], rows: int
) -> str:
    """Why environments were not set to these measured rows; empty where they were."""
    try:
        found = arrays.decode(GIVEN, recording.attachment(GIVEN) or b"")
    except DamagedRecording as error:
        return str(error)
    first = found.get(f"{TEACHER}first", np.empty(0, dtype=np.int64))
    given = [found.get(f"{TEACHER}{GROUP}/{name}") for name in _PARTS[:2]]
    if first.ndim != 1 or first.dtype.kind not in "iu" or len(first) < 2 or any(one is None for one in given):
        return "it does not have the states that it was set to"
    begin, end = (edge[envs % (len(first) - 1)].astype(np.int64) for edge in (first[:-1], first[1:]))
    for number, row in enumerate(range(rows, int(counts.max()), rows)):
        there = row < counts
        at = (begin + number)[there]
        if (at >= end[there]).any():
            return f"row {row} of a toss is not among the states that it was set to"
        for name, states in zip(_PARTS, given, strict=False):
            real = getattr(measured, name)[row, there]
            if states is None or states.shape[1:] != (1, _WIDTHS[name]) or at.max() >= len(states) or at.min() < 0:
                return f"{name} among the states that it was set to has another shape"
            if not (np.abs(states[at, 0] - real).max() < _ALIKE):
                return f"it was set to another {name} than that of the reference, at row {row}"
    return ""


def set_every(configuration: RunConfiguration) -> int:
    """Steps after which a run is set to measured states again; 0 where it is not."""
    intervention = Intervention.of(configuration.intervention)
    return intervention.step if intervention and intervention.kind.repeats else 0


def _simulated(
    recording: Recording, measured: MeasuredTosses, every: int, only: str = ""
) -> tuple[Motion, NDArray[np.int64], NDArray[np.int64]] | Missing:
    """The simulated tosses at measured rows, which tosses these are, ascending, and their environments.

    every  1: at all rows that were recorded. Else after each multiple of so many steps, without the first state
    only   EVEN or ODD; empty: those that it is judged by
    """
    c = recording.configuration
    try:
        only = only or judged_on(c.fitted)
    except ValueError as error:
        return Missing(str(error))
    if not c.initial:
        return Missing("its environments did not begin as tosses: record with --tosses")
    per_row = round(measured.dt / c.dt)
    if per_row < 1 or abs(per_row * c.dt / measured.dt - 1.0) > 1e-6:
        return Missing(f"its step, {c.dt:g} s, is no whole part of {measured.dt:g} s, the time between measured rows")
    begins = _motion(recording, np.zeros(1, dtype=np.int64))
    if isinstance(begins, Missing):
        return begins
    matched = _matched(begins, measured)
    if isinstance(matched, Missing):
        return matched
    tosses, envs = matched
    if only:
        wanted = tosses % 2 == (only == ODD)
        if not wanted.any():
            return Missing(f"it has none of the {only}, by which it is to be judged")
        tosses, envs = tosses[wanted], envs[wanted]
    steps = recording.state(GROUP, "position").steps
    steps = steps[(steps % per_row == 0) & (steps // per_row < len(measured.motion.rows))]
    rows = steps // per_row
    if rows[-1] + _gap(rows) < max(measured.known.rows) - 1:
        return Missing(f"it ends after row {rows[-1]}, and the longest toss has {max(measured.known.rows)}")
    if set_every(c):
        steps = steps[(steps % every == 0) & (steps > 0)]
        if every % per_row or not np.array_equal(steps, np.arange(1, len(steps) + 1) * every) or not len(steps):
            return Missing(f"it has no states of every {ordinal(every)} step, after which it is set to measured states")
        rows = steps // per_row
    motion = _motion(recording, steps, rows, slice(0, int(envs.max()) + 1))
    if isinstance(motion, Missing):
        return motion
    if not all(np.isfinite(getattr(motion, name)).all() for name in _PARTS):
        return Missing("its states are not all finite")
    return _of_envs(motion, envs), tosses, envs


def _matched(begins: Motion, measured: MeasuredTosses) -> tuple[NDArray[np.int64], NDArray[np.int64]] | Missing:
    """Which tosses are repeated, ascending, and the first environment that begins as each."""
    from scipy.spatial import KDTree

    first = np.concatenate([begins.position[0], _upper(begins.orientation[0])], axis=1)
    known = np.concatenate([measured.motion.position[0], _upper(measured.motion.orientation[0])], axis=1)
    if not np.isfinite(first).all():
        return Missing("its first states are not all finite")
    apart, toss = KDTree(known).query(first)
    if apart.max() > _ALIKE:
        env = int(apart.argmax())
        return Missing(f"environment {env} begins as no toss of the reference: {apart[env]:.2g} from the nearest")
    tosses, envs = np.unique(toss, return_index=True)
    return tosses, envs


def _gap(rows: NDArray[np.int64]) -> int:
    return int(np.diff(rows).max()) - 1 if len(rows) > 1 else 0


def _upper(quaternion: NDArray[np.float64]) -> NDArray[np.float64]:
    # q and -q are one orientation
    largest = np.take_along_axis(quaternion, np.abs(quaternion).argmax(axis=1)[:, np.newaxis], axis=1)
    return np.asarray(quaternion * np.sign(largest))


def _of_envs(motion: Motion, envs: NDArray[np.int64]) -> Motion:
    return Motion(
        motion.rows,
        motion.position[:, envs],
        motion.orientation[:, envs],
        motion.linear_velocity[:, envs],
        motion.angular_velocity[:, envs],
    )


def _motion(
    recording: Recording,
    steps: NDArray[np.int64],
    rows: NDArray[np.int64] | None = None,
    envs: slice = slice(None),
) -> Motion | Missing:
    """The cube's states at some steps, positions in each environment's own frame.

    rows  numbers of the measured rows at those steps; None: the steps
    envs  that are read
    """
    fields = {field.field: field for field in recording.fields if field.group == GROUP}
    if missing := [name for name in _PARTS if name not in fields]:
        return Missing(f"{missing[0]} of {GROUP} was not recorded")
    found = {}
    for name in _PARTS:
        array = recording.state(GROUP, name)
        if array.shape[2:] != (1, _WIDTHS[name]):
            return Missing(f"{name} has {array.shape[2]} bodies of {array.shape[3]} numbers; a toss has one cube")
        index = {step: at for at, step in enumerate(array.steps.tolist())}
        at = [index[step] for step in steps.tolist() if step in index]
        if not at or len(at) != len(steps):
            return Missing(f"{name} was not recorded at the steps of the measured rows")
        values = array.read(slice(at[0], at[-1] + 1), envs)[np.array(at) - at[0]]
        local = in_env_frame(recording, fields[name], values, envs) if name == "position" else values
        found[name] = local[:, :, 0].astype(np.float64)
    return Motion(steps if rows is None else rows, *(found[name] for name in _PARTS))


def _cube(recording: Recording) -> Cube:
    scene = recording.scene
    bodies = checks.objects(scene, "bodies")
    bodies = [body for body in bodies if body.get("group") == GROUP]
    if len(bodies) != 1:
        raise DamagedRecording(f"{recording.path}: the scene has {len(bodies)} bodies in {GROUP}; a toss has one cube")
    edge = checks.vector(checks.mapping(bodies[0], "shape").get("size"), 3, "the cube's size")[0]
    if not 1e-9 < edge < 1e9:
        raise DamagedRecording(f"{recording.path}: the cube's edge is {edge} m")
    mass = checks.number(bodies[0], "mass", 1e-9, 1e9)
    gravity = -checks.vector(scene.get("gravity"), 3, "gravity")[2]
    return Cube(edge, mass, mass * edge * edge / 6.0, gravity)
