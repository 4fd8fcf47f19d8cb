"""Which states are the same, by state hashes or states: classes of environments, and when they split."""

from __future__ import annotations

from dataclasses import dataclass, replace
from fractions import Fraction

import numpy as np
from numpy.typing import NDArray

from gpusimbench.evaluator.diff.common import CommonField, Selection, common_steps
from gpusimbench.evaluator.diff.result import Basis, Change, Splits, StepRange
from gpusimbench.evaluator.metrics.divergence import by_first_appearance
from gpusimbench.evaluator.missing import Missing
from gpusimbench.schemas.errors import DamagedRecording
from gpusimbench.schemas.mixing import GOLDEN, mix

PHASES = ("capture", "timed")


@dataclass(frozen=True)
class CommonHashes:
    """Recorded hashes of whole states, comparable with each other.

    phase    of the runs that they are of
    steps_a  common steps, as side a counts them, shape [step]
    a, b     shape [step, env]
    """

    phase: str
    steps_a: NDArray[np.int64]
    a: NDArray[np.uint64]
    b: NDArray[np.uint64]

    def unseen(self, steps_a: NDArray[np.int64]) -> int:
        """At how many steps hashes differ of which no state is known; states are of these captured steps."""
        captured = self.phase == "capture"
        unseen = ~np.isin(self.steps_a, steps_a) if captured else np.ones(len(self.steps_a), dtype=bool)
        return int(np.count_nonzero((self.a[unseen] != self.b[unseen]).any(axis=1)))

    def check(self, steps_a: NDArray[np.int64], differ: NDArray[np.bool_], a: Selection, b: Selection) -> None:
        """Hold the hashes against states, [step, pair]; DamagedRecording where they say otherwise."""
        if self.phase != "capture":
            return
        _, mine, theirs = np.intersect1d(self.steps_a, steps_a, assume_unique=True, return_indices=True)
        wrong = ((self.a[mine] != self.b[mine]) != differ[theirs]).any(axis=1)
        if wrong.any():
            step = int(steps_a[theirs[np.argmax(wrong)]])
            raise DamagedRecording(
                f"{a.recording.path}, {b.recording.path}: the state hashes at step {step} are not those of the states"
            )


def common_hashes(
    a: Selection, b: Selection, fields: tuple[CommonField, ...], ratio: Fraction, *, states: bool
) -> CommonHashes | Missing:
    """Hashes that both sides recorded, or why they cannot be used.

    states  whether there are common states: then hashes are those of the same phase, the capture's
    """
    why_not = _why_not(a, b, fields)
    if why_not:
        return Missing(why_not)
    for phase in PHASES[:1] if states else PHASES:
        found = _of_phase(phase, a, b, ratio)
        if found is not None:
            return found
    return Missing("not both recordings have state hashes of a common step")


def timed_hashes(
    a: Selection, b: Selection, fields: tuple[CommonField, ...], ratio: Fraction, hashes: CommonHashes | None
) -> CommonHashes | None:
    """Hashes of the timed phase beside those of the capture; None where there are none that can be compared.

    hashes  those that are compared already
    """
    if _why_not(a, b, fields) or (hashes is not None and hashes.phase == PHASES[1]):
        return None
    return _of_phase(PHASES[1], a, b, ratio)


def _of_phase(phase: str, a: Selection, b: Selection, ratio: Fraction) -> CommonHashes | None:
    of_a = a.recording.fingerprints(phase)
    of_b = of_a if b.recording is a.recording else b.recording.fingerprints(phase)
    if of_a is None or of_b is None:
        return None
    steps_a, steps_b = common_steps(of_a.steps, of_b.steps, ratio)
    if not len(steps_a):
        return None
    return CommonHashes(
        phase, steps_a,
        of_a.hashes[np.searchsorted(of_a.steps, steps_a), a.slice],
        of_b.hashes[np.searchsorted(of_b.steps, steps_b), b.slice],
    )  # fmt: skip


def _why_not(a: Selection, b: Selection, fields: tuple[CommonField, ...]) -> str:
    # a hash is over the whole state, field after field
    if [f.name for f in a.recording.fields] != [f.name for f in b.recording.fields]:
        return "the recordings have different fields, and a hash is over all of them"
    if len(fields) < len(a.recording.fields) or not all(field.whole for field in fields):
        return "the recordings have different items, and a hash is over all of them"
    if any(field.basis is Basis.FLOAT32 for field in fields):
        return "one recording is float32, the other float64"
    if any(field.basis is Basis.LOCAL for field in fields):
        return "the environments have different origins, which are part of the hashed positions"
    return "" if fields else "no fields are described"


class Counts:
    """A number at each step, kept where it changes."""

    def __init__(self) -> None:
        self._changes: list[Change] = []

    def add(self, step: int, count: int) -> None:
        """The number at the next step."""
        if not self._changes or self._changes[-1].count != count:
            self._changes.append(Change(step, count))

    def result(self) -> tuple[Change, ...]:
        """Where it changes, the first step included."""
        return tuple(self._changes)


@dataclass(frozen=True)
class FirstRow:
    """The first step at which anything differs: its number from 0, the first pair that does, and how many do."""

    row: int
    pair: int
    count: int


class Agreement:
    """What is equal at each step of a phase: pairs of environments, and of all environments those of one hash.

    phase    of the runs that the states are of
    pairs    of environments
    classes  of environments by their hashes; None where these are not asked for
    steps    that were added so far
    first    where anything differs; None where nothing does
    """

    def __init__(self, n_a: int, n_b: int, *, classes: bool, phase: str = "capture") -> None:
        self.phase = phase
        self.pairs = max(n_a, n_b)
        self.classes = Classes(n_a, n_b) if classes else None
        self.steps: list[int] = []
        self.first: FirstRow | None = None
        self._equal = Counts()

    def add(self, steps: NDArray[np.int64], differ: NDArray[np.bool_]) -> None:
        """Take in some steps: which pairs differ at each, [step, pair]."""
        for step, row in zip(steps.tolist(), differ, strict=True):
            count = int(np.count_nonzero(row))
            if count and self.first is None:
                self.first = FirstRow(len(self.steps), int(np.argmax(row)), count)
            self._equal.add(step, self.pairs - count)
            self.steps.append(step)

    def first_step(self) -> int:
        """The step of `first`."""
        if self.first is None:
            raise ValueError("nothing differs")
        return self.steps[self.first.row]

    def splits(self, no_classes: str, *, by_hashes: bool) -> Splits:
        """What is known; `no_classes` says why environments can be held against their own counterparts alone."""
        known = Splits(by_hashes, step_range(self.steps), self._equal.result(), classes_missing=no_classes)
        return self.classes.added_to(known) if self.classes else known


class Classes:
    """Distinct states of both sides at each step, and classes of trajectories."""

    def __init__(self, n_a: int, n_b: int) -> None:
        self._n_a = n_a
        self._of_a, self._of_b, self._of_both = Counts(), Counts(), Counts()
        # a running hash stands for the hashes of all steps, which would need memory by the length of a run
        self._trajectory = np.zeros(n_a + n_b, dtype=np.uint64)
        self._last = self._trajectory

    def add(self, steps: NDArray[np.int64], a: NDArray[np.uint64], b: NDArray[np.uint64]) -> None:
        """State hashes of the environments of both sides, [step, env]."""
        for step, of_a, of_b in zip(steps.tolist(), a, b, strict=True):
            both = np.concatenate([of_a, of_b])
            distinct_a, distinct_b = np.unique(of_a), np.unique(of_b)
            self._of_a.add(step, len(distinct_a))
            self._of_b.add(step, len(distinct_b))
            self._of_both.add(step, len(np.union1d(distinct_a, distinct_b)))
            self._trajectory = mix((self._trajectory + np.uint64(GOLDEN)) ^ both)
            self._last = both

    def same_up_to_order(self, other: Classes | None = None) -> bool:
        """Whether both sides have the same trajectories, each as often.

        other  of another phase of the same environments: then those of both phases together
        """
        trajectory = self._trajectory
        if other is not None:
            trajectory = mix((trajectory + np.uint64(GOLDEN)) ^ other._trajectory)
        a, b = trajectory[: self._n_a], trajectory[self._n_a :]
        return np.array_equal(np.sort(a), np.sort(b))

    def added_to(self, known: Splits) -> Splits:
        """What is known, with distinct states and classes."""
        trajectories, last = by_first_appearance(self._trajectory).tolist(), by_first_appearance(self._last).tolist()
        return replace(
            known,
            distinct_a=self._of_a.result(),
            distinct_b=self._of_b.result(),
            distinct_both=self._of_both.result(),
            classes_a=tuple(trajectories[: self._n_a]),
            classes_b=tuple(trajectories[self._n_a :]),
            last_a=tuple(last[: self._n_a]),
            last_b=tuple(last[self._n_a :]),
        )


def step_range(steps: list[int]) -> StepRange:
    """The range of some steps, of which there is at least one."""
    return StepRange(len(steps), steps[0], steps[-1])
