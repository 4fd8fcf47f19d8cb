"""Reads the common states once, step by step: counts what differs, and how far bodies lie apart."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gpusimbench.evaluator.diff.common import Selection
from gpusimbench.evaluator.diff.numbers import Pairing, Tally
from gpusimbench.evaluator.diff.result import Basis, FieldDifference, Growth
from gpusimbench.evaluator.diff.splits import Agreement, CommonHashes
from gpusimbench.evaluator.diff.states import CommonStates
from gpusimbench.evaluator.metrics.divergence import FIT_LIMIT_M, first_reaching, fit_growth
from gpusimbench.evaluator.metrics.lost_cubes import Board, Fallen
from gpusimbench.evaluator.missing import Missing
from gpusimbench.evaluator.read.scene import board_of
from gpusimbench.schemas.commands.progress import each
from gpusimbench.schemas.fingerprint import fingerprint
from gpusimbench.schemas.mixing import GOLDEN, mix

_MM, _CM = 1e-3, 1e-2

_HASH_ROWS = 512


class Distances:
    """Collects distances of bodies, chunk by chunk; the chunks of a step's groups are added together.

    boards  of both sides; None where the scene has none
    """

    def __init__(self, groups: Sequence[Pairing], boards: tuple[Board | None, Board | None] = (None, None)) -> None:
        self._groups = tuple(p.field.a.group for p in groups)
        self._spatial = all("z" in p.field.components for p in groups)
        known = self._spatial and None not in boards
        self._fallen = tuple(tuple(Fallen(board) for board in boards if board and known) for _ in groups)
        self._steps: list[int] = []
        self._rows: dict[str, list[float | None]] = {
            name: [] for name in ("median_planar", "max_planar", "median_spatial", "max_spatial")
        }
        self._not_fallen: list[float | None] = []
        self._n_fallen, self._all_fallen = 0, False
        self._not_finite: int | None = None

    def add(self, steps: NDArray[np.int64], found: Sequence[tuple[Pairing, NDArray[Any], NDArray[Any]]]) -> None:
        """Positions [step, env, item, component] of both sides, of every group."""
        planar, spatial, gone, finite = [], [], [], np.ones(len(steps), dtype=bool)
        for (how, a, b), fallen in zip(found, self._fallen, strict=True):
            apart = how.apart(a, b)
            if how.field.basis is not Basis.BITS:
                # what storing the same place twice can differ by is no distance
                apart = np.where(how.differs(a, b).any(axis=-1, keepdims=True), apart, 0.0)
            finite &= np.isfinite(a).all(axis=(1, 2, 3)) & np.isfinite(b).all(axis=(1, 2, 3))
            axes = [how.field.components.index(name) for name in ("x", "y", "z") if name in how.field.components]
            planar.append(_lengths(apart[..., axes[:2]]))
            spatial.append(_lengths(apart[..., axes]))
            if fallen:
                of_a, of_b = fallen
                below = of_a.feed((a - how.origin_a)[..., axes]) | of_b.feed((b - how.origin_b)[..., axes])
                gone.append(below.reshape(len(below), -1))
        for name, lengths in (("planar", planar), ("spatial", spatial)):
            for row in np.concatenate(lengths, axis=1):
                good = row[np.isfinite(row)]
                known = good.size > 0 and (name == "planar" or self._spatial)
                self._rows[f"median_{name}"].append(float(np.median(good)) if known else None)
                self._rows[f"max_{name}"].append(float(good.max()) if known else None)
        if gone:
            all_gone, apart = np.concatenate(gone, axis=1), np.concatenate(spatial, axis=1)
            here = np.where(all_gone | ~np.isfinite(apart), -1.0, apart).max(axis=1)
            self._not_fallen += [float(most) if most >= 0 else None for most in here]
            self._n_fallen, self._all_fallen = int(all_gone[-1].sum()), bool(all_gone[-1].all())
        if self._not_finite is None and not finite.all():
            self._not_finite = int(steps[np.argmin(finite)])
        self._steps += [int(step) for step in steps]

    def __len__(self) -> int:
        return len(self._steps)

    def result(self, dt: float) -> Growth:
        """The growth.

        dt  time step of side a [s]
        """
        times = np.array(self._steps) * dt
        not_fallen = [] if self._all_fallen else self._not_fallen
        largest = not_fallen or self._rows["max_spatial" if self._spatial else "max_planar"]
        distances = np.array([np.nan if d is None else d for d in largest])
        fit = fit_growth(times, distances, limit=FIT_LIMIT_M)
        if self._not_finite is not None and not (distances > 0).any():
            known = np.isfinite(distances).any()
            fit = Missing("no finite positions moved apart" if known else "no distance is finite")
        return Growth(
            groups=self._groups,
            steps=tuple(self._steps),
            times=tuple(times.tolist()),
            median_planar=tuple(self._rows["median_planar"]),
            max_planar=tuple(self._rows["max_planar"]),
            median_spatial=tuple(self._rows["median_spatial"]),
            max_spatial=tuple(self._rows["max_spatial"]),
            not_finite_from=self._not_finite,
            to_1mm=first_reaching(times, distances, _MM),
            to_1cm=first_reaching(times, distances, _CM),
            fit=fit,
            max_not_fallen=tuple(not_fallen),
            fallen=self._n_fallen,
        )


def _lengths(apart: NDArray[np.float64]) -> NDArray[np.float64]:
    # [step, env, item, axis] to [step, body]
    with np.errstate(invalid="ignore", over="ignore"):
        return np.asarray(np.sqrt((apart**2).sum(axis=-1)).reshape(len(apart), -1))


@dataclass(frozen=True)
class Walked:
    """What reading all common states gave.

    fields     one per common field
    agreement  of the states; its classes are by hashes of the compared numbers
    growth     None where no field tells positions
    """

    fields: tuple[FieldDifference, ...]
    agreement: Agreement
    growth: Growth | None


def walk_states(
    states: CommonStates, a: Selection, b: Selection, *, hashes: CommonHashes | None, classes: bool
) -> Walked:
    """Read everything once.

    hashes   recorded ones, to be held against the states
    classes  whether to find which environments are equal, for want of recorded hashes
    """
    tallies = [Tally(how) for how in states.fields]
    positions = [how for how in states.fields if how.field.is_position]
    distances = Distances(positions, (board_of(a.recording), board_of(b.recording))) if positions else None
    agreement = Agreement(len(a.envs), len(b.envs), classes=classes)
    for rows in each(list(states.ranges()), "comparing states"):
        steps = states.steps_a[rows]
        differ = np.zeros((len(steps), agreement.pairs), dtype=bool)
        whole, all_placed = np.ones(len(steps), dtype=bool), np.ones(len(steps), dtype=bool)
        placed: list[Any] = []
        hash_a, hash_b = (np.zeros((len(steps), len(side.envs)), dtype=np.uint64) for side in (a, b))
        for index, (how, tally) in enumerate(zip(states.fields, tallies, strict=True)):
            has = states.has(index, rows)
            whole &= has
            if how.field.is_position:
                all_placed &= has
            if not has.any():
                continue
            of_a, of_b = states.read(index, rows)
            mask = how.differs(of_a, of_b)
            tally.add(steps[has], of_a, of_b, mask)
            differ[has] |= mask.any(axis=(2, 3))
            if how.field.is_position:
                placed.append((how, has, of_a, of_b))
            if agreement.classes:
                hash_a[has] += _hash(of_a, index)
                hash_b[has] += _hash(of_b, index)
        agreement.add(steps, differ)
        if hashes is not None:
            hashes.check(steps[whole], differ[whole], a, b)  # which are over all fields
        if agreement.classes:
            agreement.classes.add(steps, hash_a, hash_b)
        if distances is not None and all_placed.any():
            bodies = [(how, of_a[all_placed[has]], of_b[all_placed[has]]) for how, has, of_a, of_b in placed]
            distances.add(steps[all_placed], bodies)
    return Walked(
        tuple(tally.result() for tally in tallies),
        agreement,
        distances.result(a.recording.configuration.dt) if distances else None,
    )


def walk_hashes(hashes: CommonHashes, *, classes: bool) -> Agreement:
    """Compare recorded hashes, as `walk_states` compares states."""
    agreement = Agreement(hashes.a.shape[1], hashes.b.shape[1], classes=classes, phase=hashes.phase)
    for begin in range(0, len(hashes.steps_a), _HASH_ROWS):
        rows = slice(begin, begin + _HASH_ROWS)
        steps, of_a, of_b = hashes.steps_a[rows], hashes.a[rows], hashes.b[rows]
        agreement.add(steps, np.asarray(of_a != of_b))
        if agreement.classes:
            agreement.classes.add(steps, of_a, of_b)
    return agreement


def _hash(array: NDArray[Any], index: int) -> NDArray[np.uint64]:
    # fields are hashed one by one, since all of them may not fit into memory
    key = np.uint64((index + 1) * GOLDEN & 0xFFFFFFFFFFFFFFFF)
    return mix(fingerprint([array]) + key)
