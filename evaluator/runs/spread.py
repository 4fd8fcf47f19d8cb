"""How the environments of one run move apart, step by step: its bodies, or its joints where it has no bodies."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from gpusimbench.evaluator.metrics.divergence import FIT_LIMIT_M, GrowthFit, fit_growth, resolution
from gpusimbench.evaluator.metrics.lost_cubes import Board, Fallen
from gpusimbench.evaluator.missing import Missing
from gpusimbench.evaluator.read.recording import Recording
from gpusimbench.evaluator.read.scene import board_of
from gpusimbench.evaluator.read.state_array import StateArray
from gpusimbench.evaluator.runs.positions import check_format, in_env_frame, joint_fields, no_states, positional
from gpusimbench.schemas.errors import DamagedRecording
from gpusimbench.schemas.fields import StateField

MAX_STEPS = 500
"""Steps of a curve; of longer recordings, every k-th row."""

_READ_BYTES = 16 << 20  # of positions at a time
_BLOCK_ROWS = 50  # of a block, at most, by the format; row 0 is a block of its own
_BLOCK_ENVS = 64


@dataclass(frozen=True)
class Spread:
    """Distances between the environments of one run.

    groups           whose positions or joints were followed
    unit             of the distances: "m" of bodies and of sliding joints, "rad" of hinges
    n_env            environments
    steps, times     recorded steps, and their simulated times [s]; at most MAX_STEPS
    rms              root mean square distance of a body between two environments, over all pairs of environments and
                     all bodies; None where a position is not finite. Of joints likewise
    largest          largest distance of a body or joint from where it is in environment 0; no two environments lie
                     further apart than twice that. None likewise
    fallen           bodies that fell off the scene's board, or through it, by the last row read. From then on neither
                     distance includes them, as in gsb-diff, because they fall for as long as is recorded; both do if
                     no body is left that fell neither in environment 0 nor in another. `largest` leaves out bodies
                     that fell in environment 0, too
    not_finite_from  first of the steps with a position that is not finite; None where all are
    resolution       largest difference that storing one place at two origins can make [m], which counts as none; None
                     where all environments have one origin
    fit              exponential through `largest`, up to FIT_LIMIT_M (of hinges as many radians)
    rows_read        of the file; rows at which all state hashes agree are not read
    bodies           whether it is of bodies, and not of joints
    """

    groups: tuple[str, ...]
    n_env: int
    steps: tuple[int, ...]
    times: tuple[float, ...]
    rms: tuple[float | None, ...]
    largest: tuple[float | None, ...]
    not_finite_from: int | None
    resolution: float | None
    fit: GrowthFit | Missing
    rows_read: int
    unit: str = "m"
    bodies: bool = True
    fallen: int = 0


def spread(recording: Recording) -> Spread | Missing:
    """Follow the environments, or say why that cannot be.

    Environment 0 is what the others are measured from: its numbers are there before the others' are read, and the
    displacement of an identical environment is exactly zero, as it would not be from a mean. The root mean square does
    not depend on that choice. With d_e the displacement of a body from environment 0,

        mean over pairs e < e' of |d_e - d_e'|^2  =  2 N / (N - 1) * (mean |d_e|^2 - |mean d_e|^2)

    so that one pass over the environments gives it, in memory that does not grow with them. The largest distance is
    what the growth is fitted to, as in gsb-diff: the root mean square of many equal environments and one that left them
    is small however far that one is.

    Where no positions were recorded, hinges are followed in the same way, or sliding joints where there are none: never
    both, since their units differ.
    """
    if recording.apart_by_design:
        return Missing(recording.apart_by_design)
    fields, unit = list(positional(recording.fields)), "m"
    for field in fields:
        check_format(recording, field)
    bodies = bool(fields)
    items: list[list[int] | None] = [None] * len(fields)
    if not bodies:
        fields, items, unit = _joints(recording)
    if not fields:
        return Missing("neither positions of bodies nor joint coordinates were recorded")
    n_env = recording.configuration.n_env
    if n_env < 2:
        return Missing("needs at least two environments")
    arrays = [recording.state(f.group, f.field) for f in fields]
    steps = arrays[0].steps
    if not len(steps):
        return no_states(recording)
    if any(not np.array_equal(a.steps, steps) for a in arrays):
        raise DamagedRecording(f"{recording.path}: the state fields have different rows")
    rows = np.arange(0, len(steps), -(-len(steps) // MAX_STEPS))
    spatial = bodies and all("z" in f.components for f in fields)
    board = board_of(recording) if spatial else None
    sums = [_Sums(recording, f, a, rows, of, board) for f, a, of in zip(fields, arrays, items, strict=True)]
    wanted = _differing(recording, steps, rows)
    for some in _chunks(rows[wanted], first_alone=int(steps[0]) == 0):
        for each in sums:
            each.read(some)
    return replace(_result(recording, fields, steps[rows], sums, int(wanted.sum())), unit=unit, bodies=bodies)


def _joints(recording: Recording) -> tuple[list[StateField], list[list[int] | None], str]:
    """Fields of joints of one unit, the places of these in each field, and the unit."""
    fields = [field for field in joint_fields(recording.fields) if field.field == "qpos"]
    for unit in ("rad", "m"):
        found = [(f, [i for i, of in enumerate(f.units) if of == unit]) for f in fields]
        if some := [(f, at) for f, at in found if at]:
            return [f for f, _ in some], [at for _, at in some], unit
    return [], [], ""


class _Sums:
    """What one field's displacements from environment 0 come to, row by row.

    bodies        of the field
    pair_squares  mean over pairs of environments of the squared distance [m^2], summed over bodies, shape [row]
    largest       distance from environment 0 [m], shape [row]
    on_board      the same of the bodies that have not fallen; None where the scene has no board
    resolution    largest that storing at two origins can make of one place [m]; None with one origin
    """

    def __init__(
        self,
        recording: Recording,
        field: StateField,
        array: StateArray,
        rows: NDArray[np.int64],
        of: list[int] | None,
        board: Board | None,
    ) -> None:
        self._of = of
        self._recording, self._array, self._rows = recording, array, rows
        simulation = recording.simulation
        origins = simulation.env_origins if simulation and field.frame == "world" else ()
        self._origins = np.array(origins) if len(set(origins)) > 1 else None
        self.bodies = len(field.items) if of is None else len(of)
        self.pair_squares = np.zeros(len(rows))
        self.largest = np.zeros(len(rows))
        self.resolution = 0.0 if self._origins is not None else None
        # whole blocks of environments, as the format cuts them: none is decoded twice
        _, n_env, items, width = array.shape
        block = max(_BLOCK_ENVS, n_env // _BLOCK_ENVS)
        row_bytes = min(_BLOCK_ROWS, len(array.steps)) * block * items * width * array.dtype.itemsize
        self._envs = block * max(1, _READ_BYTES // max(row_bytes, 1))
        self.on_board = _OnBoard(recording, array, board, len(rows), self._envs) if board else None

    def read(self, some: NDArray[np.int64]) -> None:
        """Add rows of the file, all within one block of rows."""
        begin, end = int(some[0]), int(some[-1]) + 1
        at = np.searchsorted(self._rows, some)
        n_env, _, width = self._array.shape[1:]
        zero = self._array.read(slice(begin, end), slice(0, 1))[some - begin]
        squares, vectors = np.zeros(len(some)), np.zeros((len(some), self.bodies, width))
        for first in range(0, n_env, self._envs):
            part = self._array.read(slice(begin, end), slice(first, first + self._envs))[some - begin]
            apart = self._apart(part, zero, first)
            apart = apart if self._of is None else apart[:, :, self._of]
            with np.errstate(invalid="ignore", over="ignore"):
                squared = (apart**2).sum(axis=-1)
                squares += squared.sum(axis=(1, 2))
                vectors += apart.sum(axis=1)
                self.largest[at] = np.maximum(self.largest[at], np.sqrt(squared.max(axis=(1, 2))))
            if self.on_board:
                self.on_board.add(at, first, part, apart, squared)
        with np.errstate(invalid="ignore", over="ignore"):
            around = squares / n_env - ((vectors / n_env) ** 2).sum(axis=(1, 2))
            self.pair_squares[at] = 2 * n_env / (n_env - 1) * np.maximum(around, 0.0)

    def _apart(self, part: NDArray[np.floating], zero: NDArray[np.floating], first: int) -> NDArray[np.float64]:
        # [row, env, item, component], in the environments' own frames
        with np.errstate(invalid="ignore", over="ignore"):
            apart = part.astype(np.float64) - zero.astype(np.float64)
            if self._origins is None:
                return np.asarray(apart)
            origins = self._origins[:, : apart.shape[-1]]
            apart = apart - (origins[first : first + part.shape[1]] - origins[0])[np.newaxis, :, np.newaxis]
            limit = resolution(part, np.broadcast_to(zero, part.shape))
            finest = limit[np.isfinite(limit)]
            self.resolution = max(self.resolution or 0.0, float(finest.max()) if finest.size else 0.0)
            beyond = ~(np.abs(apart) <= limit)
        # what storing the same place twice can differ by is no distance
        return np.asarray(np.where(beyond.any(axis=-1, keepdims=True), apart, 0.0))


class _OnBoard:
    """The displacements of those bodies of one field that have not fallen off the board, row by row.

    squares, vectors  sums over environments [m^2] and [m], shapes [row, body] and [row, body, 3]
    count             environments in which each body is on the board, shape [row, body]
    largest           distance from environment 0 [m], shape [row]; zero where no body is on the board
    fallen            bodies of all environments that have fallen, shape [row]; zero at rows that are not read
    compared          bodies of other environments that `largest` is of, shape [row]; likewise
    last              the last row that was read
    """

    def __init__(self, recording: Recording, array: StateArray, board: Board, rows: int, envs: int) -> None:
        self._recording, self._field = recording, array.field
        _, n_env, bodies, width = array.shape
        self.squares, self.count = np.zeros((rows, bodies)), np.zeros((rows, bodies), dtype=np.int64)
        self.vectors = np.zeros((rows, bodies, width))
        self.largest = np.zeros(rows)
        self.fallen, self.compared = np.zeros(rows, dtype=np.int64), np.zeros(rows, dtype=np.int64)
        self.last = 0
        self._following = {first: Fallen(board) for first in range(0, n_env, envs)}
        # a body that has fallen was higher once, and rows at which all environments agree are not read
        start = in_env_frame(recording, array.field, array.at_step(int(array.steps[0])))
        for first, following in self._following.items():
            following.feed(start[np.newaxis, first : first + envs])
        self._zero = np.zeros((1, 1, bodies), dtype=bool)

    def add(
        self,
        at: NDArray[np.int64],
        first: int,
        part: NDArray[np.floating],
        apart: NDArray[np.float64],
        squared: NDArray[np.float64],
    ) -> None:
        """Positions of environments from `first` on, and their displacements, at the rows `at`."""
        envs = slice(first, first + part.shape[1])
        fallen = self._following[first].feed(in_env_frame(self._recording, self._field, part, envs))
        self._zero = fallen[:, :1] if first == 0 else self._zero
        self.fallen[at] += fallen.sum(axis=(1, 2))
        self.last = int(at[-1])
        self.count[at] += (~fallen).sum(axis=1)
        self.squares[at] += np.where(fallen, 0.0, squared).sum(axis=1)
        self.vectors[at] += np.where(fallen[..., np.newaxis], 0.0, apart).sum(axis=1)
        gone = fallen | self._zero
        self.compared[at] += (~gone[:, 1 if first == 0 else 0 :]).sum(axis=(1, 2))
        here = np.where(gone, 0.0, squared).max(axis=(1, 2))
        self.largest[at] = np.maximum(self.largest[at], np.sqrt(here))


def _differing(recording: Recording, steps: NDArray[np.int64], rows: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Which of the rows have to be read: where the hashes of all environments agree, so do their positions."""
    captured = recording.fingerprints("capture")
    if captured is None:
        return np.ones(len(rows), dtype=bool)
    agree = captured.steps[(captured.hashes == captured.hashes[:, :1]).all(axis=1)]
    return ~np.isin(steps[rows], agree)


def _chunks(rows: NDArray[np.int64], *, first_alone: bool) -> Iterator[NDArray[np.int64]]:
    """The rows, cut where the recorder cuts its blocks."""
    offset = _BLOCK_ROWS - 1 if first_alone else 0
    block = (rows + offset) // _BLOCK_ROWS
    for number in np.unique(block):
        yield rows[block == number]


def _result(
    recording: Recording, fields: list[StateField], steps: NDArray[np.int64], sums: list[_Sums], rows_read: int
) -> Spread:
    bodies = sum(s.bodies for s in sums)
    rms = np.sqrt(sum((s.pair_squares for s in sums), np.zeros(len(steps))) / bodies)
    largest = np.max([s.largest for s in sums], axis=0)
    finite = np.isfinite(largest) & np.isfinite(rms)
    boards = [s.on_board for s in sums if s.on_board]
    fallen = int(sum(b.fallen[b.last] for b in boards))
    if any(b.fallen.any() for b in boards) and any(b.compared[b.last] for b in boards):
        rms, largest = _of_those_on_board(boards)
    times = np.asarray(steps * recording.configuration.dt, dtype=np.float64)
    resolutions = [s.resolution for s in sums if s.resolution is not None]
    return Spread(
        groups=tuple(f.group for f in fields),
        n_env=recording.configuration.n_env,
        steps=tuple(steps.tolist()),
        times=tuple(times.tolist()),
        rms=_finite(rms, finite),
        largest=_finite(largest, finite),
        not_finite_from=None if finite.all() else int(steps[np.argmin(finite)]),
        resolution=max(resolutions) if resolutions else None,
        fit=fit_growth(times, np.where(finite, largest, np.nan), limit=FIT_LIMIT_M),
        rows_read=rows_read,
        fallen=fallen,
    )


def _of_those_on_board(boards: list[_OnBoard]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Root mean square and largest distance; both shape [row]."""
    squares, pairs = 0.0, 0
    with np.errstate(invalid="ignore", over="ignore", divide="ignore"):
        for one in boards:
            squares = squares + (one.count * one.squares - (one.vectors**2).sum(axis=-1)).clip(min=0.0).sum(axis=1)
            pairs = pairs + (one.count * (one.count - 1) // 2).sum(axis=1)
        rms = np.sqrt(squares / np.maximum(pairs, 1))
    return rms, np.max([one.largest for one in boards], axis=0)


def _finite(values: NDArray[np.float64], finite: NDArray[np.bool_]) -> tuple[float | None, ...]:
    return tuple(float(v) if good else None for v, good in zip(values, finite, strict=True))
