"""Which environments of one or several recordings are bit-identical so far, step by step, from their state hashes."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gpusimbench.evaluator.metrics.identity import refined
from gpusimbench.evaluator.read.recording import Recording

_MOST_HASHES = 1 << 25
"""That are held at once, of all recordings together; environments beyond are left out, and that is said."""

_MIXED = 3  # recordings whose environments are taken by turns

_MOST_CHANGES = 4000
"""Steps at which the classes change that a page is given."""


@dataclass(frozen=True)
class ComparableHashes:
    """State hashes of environments that can be held against each other bit by bit.

    recording, env  which environment a column is of: index of its recording, number; shape [member]
    steps           simulator steps that all recordings have hashes of, shape [row]
    hashes          shape [row, member]
    left_out        in a sentence, environments that are not among the members; empty where all are
    """

    recording: NDArray[np.int64]
    env: NDArray[np.int64]
    steps: NDArray[np.int64]
    hashes: NDArray[np.uint64]
    left_out: str

    def member(self, recording: int, env: int) -> int | None:
        """The column of an environment; None where it is not among the members."""
        found = np.flatnonzero((self.recording == recording) & (self.env == env))
        return int(found[0]) if found.size else None


@dataclass(frozen=True)
class Changes:
    """The classes of some members, at the steps at which anything about them changes; the first step is one.

    steps    simulator steps, shape [change]
    so_far   distinct members by all steps up to that one, shape [change]; never falls
    instant  distinct members at that step alone, shape [change]
    leader   of each shown member, the first shown member that is bit-identical with it so far, shape [change, shown]
    size     how many of all members are bit-identical with it so far, itself included, shape [change, shown]
    complete whether no later changes were left out for their number
    last_compared  the last step that is known
    """

    steps: NDArray[np.int64]
    so_far: NDArray[np.int64]
    instant: NDArray[np.int64]
    leader: NDArray[np.int64]
    size: NDArray[np.int64]
    complete: bool
    last_compared: int

    @property
    def first_divergence(self) -> int | None:
        """The first step at which not all members are the same; None where they always are."""
        apart = np.flatnonzero(self.so_far > 1)
        return int(self.steps[apart[0]]) if apart.size else None

    @property
    def splits(self) -> NDArray[np.int64]:
        """Steps at which members that were bit-identical part, shape [split]."""
        before = np.concatenate([[1], self.so_far[:-1]])
        return self.steps[self.so_far > before]


def compared(recordings: Sequence[Recording]) -> ComparableHashes | str:
    """Hashes of the capture phase of all environments that share an origin with the first; or why there are none."""
    why_not = _why_not(recordings)
    if why_not:
        return why_not
    found = [recording.fingerprints("capture") for recording in recordings]
    if any(of_one is None for of_one in found):
        return "some recordings have no state hashes, so bits cannot be compared"
    hashes = [of_one for of_one in found if of_one is not None]
    steps = hashes[0].steps
    for of_one in hashes[1:]:
        steps = np.intersect1d(steps, of_one.steps)
    if not steps.size:
        return "no step has state hashes in all recordings"
    members = [_alike(recordings[0], recording) for recording in recordings]
    if len(members) == 1 and len(members[0]) == 1 < recordings[0].configuration.n_env:
        return "the environments have different origins, which are part of the bits of their positions"
    most = max(1, _MOST_HASHES // (len(steps) * len(recordings)))
    kept = [envs[:most] for envs in members]
    return ComparableHashes(
        np.repeat(np.arange(len(kept)), [len(envs) for envs in kept]),
        np.concatenate(kept),
        steps,
        np.concatenate(
            [
                one.hashes[np.ix_(np.searchsorted(one.steps, steps), envs)]
                for one, envs in zip(hashes, kept, strict=True)
            ],
            axis=1,
        ),
        _left_out(recordings, members, kept),
    )


def representatives(found: ComparableHashes, most: int) -> list[int]:
    """Members that stand for the classes, the first of each class, in the order in which the classes split off.

    Of classes that split off at one step, those of the same environment in the first few recordings are next to each
    other, so that differences between runs and differences between environments are both among the first.
    """

    def turn(member: int) -> tuple[bool, int, int]:
        recording = int(found.recording[member])
        return recording >= _MIXED, int(found.env[member]), recording

    order: dict[int, None] = {}
    for _, classes, _, _ in _changed(found.hashes):
        order |= dict.fromkeys(sorted(np.unique(classes, return_index=True)[1].tolist(), key=turn))
        if len(order) >= most:
            break
    return list(order)[:most]


def changes(found: ComparableHashes, shown: Sequence[int]) -> Changes:
    """The classes of some members over time, among all members."""
    kept: list[tuple[Any, ...]] = []
    complete, before = True, 0
    for row, classes, count, instant in _changed(found.hashes):
        if len(kept) >= _MOST_CHANGES:
            complete = False
            if count == before:
                continue  # they meet or part again; a new class is never left out unsaid
            break
        mine = classes[list(shown)]
        leader = [int(np.flatnonzero(mine == own)[0]) for own in mine]
        kept.append((found.steps[row], count, instant, leader, np.bincount(classes)[mine]))
        before = count
    steps, so_far, at_once, leaders, sizes = zip(*kept, strict=True)
    last = int(found.steps[-1]) if complete else int(steps[-1])
    return Changes(
        np.array(steps), np.array(so_far), np.array(at_once), np.array(leaders), np.array(sizes), complete, last
    )


def _changed(hashes: NDArray[np.uint64]) -> Iterator[tuple[int, NDArray[np.int64], int, int]]:
    """Rows of `refined` at which either count is not what it was at the row before, with their numbers; and row 0."""
    before = (0, 0)
    for row, (classes, count, instant) in enumerate(refined(hashes)):
        if (count, instant) != before:
            yield row, classes, count, instant
        before = (count, instant)


def _why_not(recordings: Sequence[Recording]) -> str:
    described = [[(f.name, f.dtype, f.items, f.components) for f in recording.fields] for recording in recordings]
    if any(one != described[0] for one in described):
        return "the recordings have different fields, items or precision, so their bits cannot be compared"
    if len({recording.configuration.dt for recording in recordings}) > 1:
        return "the recordings have different time steps"
    return ""


def _alike(first: Recording, recording: Recording) -> NDArray[np.int64]:
    # environments whose recorded positions have the same origin in them as those of the first one's env 0
    anchor, origins = (r.simulation.env_origins if r.simulation else () for r in (first, recording))
    here = anchor[0] if anchor else (0.0, 0.0, 0.0)
    if not origins:
        return np.arange(recording.configuration.n_env if not any(here) else 0)
    return np.flatnonzero((np.array(origins) == np.array(here)).all(axis=1))


def _left_out(recordings: Sequence[Recording], members: list[NDArray[np.int64]], kept: list[NDArray[np.int64]]) -> str:
    total = sum(recording.configuration.n_env for recording in recordings)
    alike = sum(map(len, members))
    few = sum(map(len, kept))
    if few < alike:
        return f"bits of the first {few} of {total} environments are compared; those of all would need too much memory"
    if alike < total:
        return f"bits of {alike} of {total} environments are compared: the others have other origins"
    return ""
