"""Bit-identity: which samples are the same bytes, and since when they are not; and that as a tree of splits."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from gpusimbench.evaluator.metrics.divergence import by_first_appearance

MAX_BRANCHES = 64
"""Branches that are kept; of more, those that left first."""

MAX_MEMBERS = 16
"""Members of a branch that are named."""


def unchanging(samples: npt.NDArray[np.uint64]) -> bool:
    """Whether there are several samples, and all are the first one.

    Args:
        samples: hashes, shape [n_sample, ...].
    """
    return len(samples) > 1 and bool((samples == samples[0]).all())


def bitwise_classes(samples: npt.ArrayLike) -> npt.NDArray[np.int64]:
    """Group samples by their bytes.

    Bytes, not values: NaNs are equal only with the same payload, and -0.0 differs from 0.0. This is
    the strongest statement of equality, stronger than a published distance of "0.00 cm".

    Args:
        samples: any numeric array [any unit], shape [n_sample, ...].

    Returns:
        class of every sample, numbered 0, 1, ... in order of first appearance, shape [n_sample].

    Raises:
        ValueError: samples are a scalar, or Python objects, which have no bytes to compare.
    """
    array = np.asarray(samples)
    if array.ndim == 0:
        raise ValueError("samples must have at least one axis, got a scalar")
    if array.dtype.hasobject:
        raise ValueError("samples are Python objects: there are no bytes to compare")
    classes: dict[bytes, int] = {}
    labels = [classes.setdefault(sample.tobytes(), len(classes)) for sample in array]
    return np.array(labels, dtype=np.int64)


def count_distinct(samples: npt.ArrayLike) -> int:
    """Number of bitwise different samples (see `bitwise_classes`), shape [n_sample, ...]."""
    return int(bitwise_classes(samples).max(initial=-1)) + 1


@dataclass(frozen=True)
class DistinctOverTime:
    """How many samples are different, row by row.

    instant    distinct samples at that row alone, shape [row]; falls where samples meet again
    histories  distinct samples by all rows up to that one, shape [row]; never falls
    classes    class of every sample by all rows, shape [sample]
    departures where classes fall apart, shape [departure, 4]: the row; the lowest sample of those that leave; the
               lowest of those that they leave; how many leave. By row, then sample. Of a class, the part with its
               lowest sample stays
    """

    instant: npt.NDArray[np.int64]
    histories: npt.NDArray[np.int64]
    classes: npt.NDArray[np.int64]
    departures: npt.NDArray[np.int64]


def changes(instant: npt.NDArray[np.int64], histories: npt.NDArray[np.int64]) -> npt.NDArray[np.int64]:
    """Rows at which either count is not what it was at the row before, and row 0, shape [change]."""
    both = np.stack([instant, histories], axis=1)
    moved = (both[1:] != both[:-1]).any(axis=1)
    return np.flatnonzero(np.concatenate([np.ones(min(len(both), 1), dtype=bool), moved]))


def refined(
    hashes: npt.NDArray[np.uint64],
) -> Iterator[tuple[npt.NDArray[np.int64], int, int]]:
    """The classes of samples by all rows up to each row, in order of first appearance.

    Yields for every row the class of each sample, shape [sample]; how many classes there are; and how many distinct
    samples that row alone has.

    hashes  as for `distinct_over_time`
    """
    n_sample = hashes.shape[1]
    classes = np.zeros(n_sample, dtype=np.int64)
    count = 1
    for now in hashes:
        instant = 1
        if (now != now[:1]).any():
            labels = by_first_appearance(now) if now.ndim == 1 else bitwise_classes(now)
            instant = int(labels.max()) + 1
            if count < n_sample:
                classes = by_first_appearance((classes * n_sample + labels).astype(np.uint64))
                count = int(classes.max()) + 1
        yield classes, count, instant


def distinct_over_time(hashes: npt.NDArray[np.uint64]) -> DistinctOverTime:
    """Count distinct samples at each row and along their histories.

    Exact on the hashes: two samples share a history where they share a class so far and this row's hashes. Time grows
    as row * sample * log(sample); memory beyond the hashes as sample.

    Args:
        hashes: of envs [row, env], or of runs, env by env [row, run, env].

    Raises:
        ValueError: another number of axes, or no samples.
    """
    if hashes.ndim not in (2, 3) or hashes.shape[1] == 0:
        raise ValueError(f"hashes must have shape [row, env] or [row, run, env], got {list(hashes.shape)}")
    n_row, n_sample = hashes.shape[:2]
    instant = np.ones(n_row, dtype=np.int64)
    histories = np.ones(n_row, dtype=np.int64)
    classes = np.zeros(n_sample, dtype=np.int64)
    departures = [np.zeros((0, 4), dtype=np.int64)]
    count = 1
    for row, (finer, now_count, instant[row]) in enumerate(refined(hashes)):
        if now_count > count:
            departures.append(_departures(row, classes, finer))
        classes, count = finer, now_count
        histories[row] = count
    return DistinctOverTime(instant, histories, classes, np.concatenate(departures))


def _departures(row: int, classes: npt.NDArray[np.int64], finer: npt.NDArray[np.int64]) -> npt.NDArray[np.int64]:
    """What leaves what where classes become finer ones; both are numbered in order of first appearance."""
    _, lowest = np.unique(classes, return_index=True)
    _, first, sizes = np.unique(finer, return_index=True, return_counts=True)
    stayed_with = lowest[classes[first]]
    leaves = first != stayed_with
    return np.column_stack([np.full(leaves.sum(), row), first[leaves], stayed_with[leaves], sizes[leaves]])


@dataclass(frozen=True)
class Branch:
    """A class of samples with one history, from the step at which it left the branch that it was part of.

    Where a class falls apart, the part with its lowest sample goes on as the same branch, and every other part is a
    branch of its own.

    sample   lowest of its samples, which names it
    parent   place in the tree of the branch that it left; None for the first
    step     first step at which it differs from its parent; the first step that was recorded, for the first
    left     samples that left together
    stayed   samples that are still in it at the end: what is left of it by later splits
    members  the lowest of those that stayed, at most MAX_MEMBERS
    """

    sample: int
    parent: int | None
    step: int
    left: int
    stayed: int
    members: tuple[int, ...]


@dataclass(frozen=True)
class SplitTree:
    """All branches in order of step, then sample.

    branches    the first of them is the one with sample 0
    not_kept    branches that left after those that are kept
    first_step  first recorded step
    last_step   last recorded step
    """

    branches: tuple[Branch, ...]
    not_kept: int
    first_step: int
    last_step: int


def split_tree(steps: npt.NDArray[np.int64], counted: DistinctOverTime) -> SplitTree:
    """The tree of some counted samples.

    Args:
        steps: of the rows that were counted, shape [row].
    """
    first, last = (int(steps[0]), int(steps[-1])) if len(steps) else (0, 0)
    kept = counted.departures[: MAX_BRANCHES - 1]
    # of a kept branch, a parent left before it, so it is kept as well
    place = {0: 0, **{int(sample): at for at, (_, sample, _, _) in enumerate(kept, start=1)}}
    root = _branch(counted, 0, None, first, len(counted.classes))
    others = [
        _branch(counted, int(sample), place[int(parent)], int(steps[row]), int(left))
        for row, sample, parent, left in kept
    ]
    return SplitTree((root, *others), len(counted.departures) - len(kept), first, last)


def _branch(counted: DistinctOverTime, sample: int, parent: int | None, step: int, left: int) -> Branch:
    alike = np.flatnonzero(counted.classes == counted.classes[sample])
    return Branch(sample, parent, step, left, len(alike), tuple(alike[:MAX_MEMBERS].tolist()))
