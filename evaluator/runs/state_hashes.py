"""Hashes of a run's states and of its program's arrays, reduced to what comparing environments and runs needs."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gpusimbench.evaluator.metrics.identity import SplitTree, distinct_over_time, split_tree, unchanging
from gpusimbench.evaluator.read.digests import Updates
from gpusimbench.evaluator.read.recording import Recording
from gpusimbench.evaluator.read.streams import Fingerprints


@dataclass(frozen=True)
class Histories:
    """The captured states of one run by bits.

    steps       simulator step of each row, shape [row]
    digests     128-bit digest of the hashes of all environments, in their order, shape [row, 2]
    classes     of the environments by their whole history, numbered in order of first appearance, shape [env]
    at_step     distinct environments at that very row, shape [row]
    so_far      distinct environments by all rows up to that one, shape [row]
    first_step  the first step at which any two environments differ; None where none do
    tree        which environments left which, and when
    """

    steps: NDArray[np.int64]
    digests: NDArray[np.uint64]
    classes: NDArray[np.int64]
    at_step: NDArray[np.int64]
    so_far: NDArray[np.int64]
    first_step: int | None
    tree: SplitTree

    @property
    def n_distinct(self) -> int:
        """Environments with different histories."""
        return int(self.classes.max(initial=-1)) + 1

    @property
    def still(self) -> bool:
        """Whether several states were captured, and all are the first one in every bit."""
        return unchanging(self.digests)

    def until(self, rows: int) -> bytes:
        """The first rows of all environments, as bytes that are equal exactly where those are."""
        return self.steps[:rows].tobytes() + self.digests[:rows].tobytes()


def histories_of(fingerprints: Fingerprints) -> Histories:
    """Boil down the hashes of a phase."""
    hashes = np.ascontiguousarray(fingerprints.hashes)
    digests = [hashlib.blake2b(row, digest_size=16).digest() for row in hashes]
    counted = distinct_over_time(hashes)
    apart = np.flatnonzero(counted.instant > 1)
    return Histories(
        steps=fingerprints.steps,
        digests=np.frombuffer(b"".join(digests), dtype=np.uint64).reshape(-1, 2),
        classes=counted.classes,
        at_step=counted.instant,
        so_far=counted.histories,
        first_step=int(fingerprints.steps[apart[0]]) if len(apart) else None,
        tree=split_tree(fingerprints.steps, counted),
    )


def side_by_side(runs: Sequence[Histories]) -> tuple[NDArray[np.int64], NDArray[np.uint64]] | None:
    """Digests of several runs at every step that any of them captured, or None where no step is common to all.

    Runs of one group may have captured for different lengths of time. Two runs are compared at the steps that both
    captured. Where a run captured nothing, it takes the digests of the first longer run that it equals at all common
    steps: a run that ends early is told apart by what it captured, and hides no difference between the others.

    Returns the steps, shape [row], and the digests, shape [row, run, 2].
    """
    steps = np.unique(np.concatenate([run.steps for run in runs]))
    digests = np.zeros((len(steps), len(runs), 2), dtype=np.uint64)
    captured = np.zeros((len(steps), len(runs)), dtype=bool)
    for index, run in enumerate(runs):
        rows = np.searchsorted(steps, run.steps)
        digests[rows, index], captured[rows, index] = run.digests, True
    if captured.all():
        return steps, digests
    if not captured.all(axis=1).any():
        return None
    classes: list[list[int]] = []  # the first of each is the longest
    for index in sorted(range(len(runs)), key=lambda one: -len(runs[one].steps)):
        equal = (one for one in classes if _equal_where_both(digests, captured, index, one))
        if (found := next(equal, None)) is None:
            classes.append([index])
        else:
            found.append(index)
    for members in classes:
        _fill(digests, captured, members, members)
    for members in classes:  # later than any of a class goes, it is not told apart from the longest run
        _fill(digests, captured, members, classes[0][:1])
    return steps, digests


def _equal_where_both(
    digests: NDArray[np.uint64], captured: NDArray[np.bool_], one: int, others: Sequence[int]
) -> bool:
    return all(
        np.array_equal(digests[both, one], digests[both, other])
        for other in others
        for both in (captured[:, one] & captured[:, other],)
    )


def _fill(
    digests: NDArray[np.uint64], captured: NDArray[np.bool_], members: Sequence[int], sources: Sequence[int]
) -> None:
    for member in members:
        for source in sources:
            rows = captured[:, source] & ~captured[:, member]
            digests[rows, member] = digests[rows, source]
            captured[rows, member] = True


@dataclass(frozen=True)
class ArrayHistory:
    """Updates of the arrays of one name.

    states   how many states precede each, shape [update]
    order    number of each among the updates of all names, shape [update]
    digests  128-bit digest of each: of names, dtypes, shapes and hashes of its arrays, and of `states`; [update, 2]
    """

    states: NDArray[np.int64]
    order: NDArray[np.int64]
    digests: NDArray[np.uint64]


def array_histories(recording: Recording) -> dict[str, ArrayHistory]:
    """Histories of arrays by name; empty where the program hashed no arrays."""
    return {name: _history(updates) for name, updates in recording.program.items()}


def _history(updates: Updates) -> ArrayHistory:
    digests = [
        hashlib.blake2b(
            "\0".join([str(states), *arrays]).encode(errors="replace") + hashes.tobytes(), digest_size=16
        ).digest()
        for states, arrays, hashes in zip(updates.states, updates.arrays, updates.hashes, strict=True)
    ]
    return ArrayHistory(updates.states, updates.order, np.frombuffer(b"".join(digests), dtype=np.uint64).reshape(-1, 2))
