"""Tosses out of recordings: the measured ones of a reference, and which of them each simulated environment repeats."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from gpusimbench.evaluator.metrics.tosses import Cube, Motion, TossErrors, TrackingFloor, toss_errors, tracking_floor
from gpusimbench.evaluator.missing import Missing
from gpusimbench.evaluator.read.recording import Recording
from gpusimbench.evaluator.runs.positions import in_env_frame
from gpusimbench.schemas import checks
from gpusimbench.schemas.errors import DamagedRecording
from gpusimbench.schemas.fields import BODY_FIELDS
from gpusimbench.schemas.tosses import GROUP, TOSSES, TossSet

_ALIKE = 1e-4  # of two first states [m, and of quaternions]: float32 far from the origin rounds to 8e-6 m
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
        return f"{len(self.known.rows)} tosses: {self.known.source}"


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
    if max(known.rows) > len(motion.rows):
        raise DamagedRecording(
            f"{recording.path}: {TOSSES} has a toss of {max(known.rows)} rows, more than are recorded"
        )
    cube = _cube(recording)
    first = motion.linear_velocity[0] - np.array([0.0, 0.0, cube.gravity * c.dt * _HALF_STEP])
    floor = tracking_floor(motion, np.array(known.rows), cube, c.dt, first)
    return MeasuredTosses(known, motion, cube, c.dt, floor)


def errors_of(recording: Recording, measured: MeasuredTosses) -> TossErrors | Missing:
    """Errors of a simulation of measured tosses, in the order of the tosses.

    Of a toss that several environments repeat, those of the first; the reason where they cannot be computed.
    """
    c = recording.configuration
    if not c.initial:
        return Missing("its environments did not begin as tosses: record with --tosses")
    per_row = round(measured.dt / c.dt)
    if per_row < 1 or abs(per_row * c.dt / measured.dt - 1.0) > 1e-6:
        return Missing(f"its step, {c.dt:g} s, is no whole part of {measured.dt:g} s, the time between measured rows")
    array = recording.state(GROUP, "position") if f"{GROUP}/position" in {f.name for f in recording.fields} else None
    if array is None or not len(array):
        return Missing("no states of the cube were recorded")
    steps = array.steps[array.steps % per_row == 0]
    rows = steps // per_row
    steps, rows = steps[rows < len(measured.motion.rows)], rows[rows < len(measured.motion.rows)]
    if not len(rows) or rows[0] != 0:
        return Missing("its first state was not recorded")
    if rows[-1] + _gap(rows) < max(measured.known.rows) - 1:
        return Missing(f"it ends after row {rows[-1]}, and the longest toss has {max(measured.known.rows)}")
    motion = _motion(recording, steps, rows)
    if isinstance(motion, Missing):
        return motion
    return _judged(motion, measured)


def _judged(motion: Motion, measured: MeasuredTosses) -> TossErrors | Missing:
    if not all(np.isfinite(a).all() for a in (motion.position, motion.orientation, motion.linear_velocity)):
        return Missing("its states are not all finite")
    begins = np.concatenate([motion.position[0], _upper(motion.orientation[0])], axis=1)
    known = np.concatenate([measured.motion.position[0], _upper(measured.motion.orientation[0])], axis=1)
    apart, toss = KDTree(known).query(begins)
    if apart.max() > _ALIKE:
        env = int(apart.argmax())
        return Missing(f"environment {env} begins as no toss of the reference: {apart[env]:.2g} from the nearest")
    tosses, envs = np.unique(toss, return_index=True)
    return toss_errors(
        _of(motion, envs), _of(measured.motion, tosses), measured.counts[tosses], measured.cube, measured.dt
    )


def _gap(rows: NDArray[np.int64]) -> int:
    return int(np.diff(rows).max()) - 1 if len(rows) > 1 else 0


def _upper(quaternion: NDArray[np.float64]) -> NDArray[np.float64]:
    # q and -q are one orientation
    largest = np.take_along_axis(quaternion, np.abs(quaternion).argmax(axis=1)[:, np.newaxis], axis=1)
    return np.asarray(quaternion * np.sign(largest))


def _of(motion: Motion, envs: NDArray[np.int64]) -> Motion:
    return Motion(
        motion.rows,
        motion.position[:, envs],
        motion.orientation[:, envs],
        motion.linear_velocity[:, envs],
        motion.angular_velocity[:, envs],
    )


def _motion(recording: Recording, steps: NDArray[np.int64], rows: NDArray[np.int64] | None = None) -> Motion | Missing:
    """The cube's states at some steps, positions in each environment's own frame."""
    fields = {field.field: field for field in recording.fields if field.group == GROUP}
    if missing := [name for name in BODY_FIELDS if name not in fields]:
        return Missing(f"{missing[0]} of {GROUP} was not recorded")
    found = {}
    for name in BODY_FIELDS:
        array = recording.state(GROUP, name)
        if array.shape[2] != 1:
            return Missing(f"it has {array.shape[2]} bodies in {GROUP}, and a toss has one cube")
        index = {step: at for at, step in enumerate(array.steps.tolist())}
        at = [index[step] for step in steps.tolist() if step in index]
        if len(at) != len(steps):
            return Missing(f"{name} was not recorded at the steps of the measured rows")
        values = np.asarray(array)[at]
        found[name] = in_env_frame(recording, fields[name], values) if name == "position" else values.astype(np.float64)
    return Motion(
        steps if rows is None else rows,
        found["position"][:, :, 0],
        found["orientation"][:, :, 0],
        found["linear_velocity"][:, :, 0],
        found["angular_velocity"][:, :, 0],
    )


def _cube(recording: Recording) -> Cube:
    scene = recording.scene
    bodies = checks.objects(scene, "bodies")
    bodies = [body for body in bodies if body.get("group") == GROUP]
    if len(bodies) != 1:
        raise DamagedRecording(f"{recording.path}: the scene has {len(bodies)} bodies in {GROUP}; a toss has one cube")
    edge = checks.vector(_shape(bodies[0]).get("size"), 3, "the cube's size")[0]
    mass = checks.number(bodies[0], "mass", 1e-9, 1e9)
    gravity = -checks.vector(scene.get("gravity"), 3, "gravity")[2]
    return Cube(edge, mass, mass * edge * edge / 6.0, gravity)


def _shape(body: Mapping[str, Any]) -> Mapping[str, Any]:
    return checks.mapping(body, "shape")
