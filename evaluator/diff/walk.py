"""Reads the common states once, step by step, and counts what differs."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gpusimbench.evaluator.diff.growth import Distances
from gpusimbench.evaluator.diff.hashes import CommonHashes
from gpusimbench.evaluator.diff.numbers import Tally
from gpusimbench.evaluator.diff.result import FieldDifference, Growth
from gpusimbench.evaluator.diff.selection import Selection
from gpusimbench.evaluator.diff.splits import Agreement
from gpusimbench.evaluator.diff.states import CommonStates
from gpusimbench.evaluator.read.scene import board_of
from gpusimbench.schemas.commands.progress import each
from gpusimbench.schemas.fingerprint import fingerprint
from gpusimbench.schemas.mixing import GOLDEN, mix

_HASH_ROWS = 512


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
    """The same of recorded hashes."""
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
