"""Which states are the same: classes of environments, and when they split."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from gpusimbench.evaluator.diff.result import Change, Splits, StepRange
from gpusimbench.evaluator.metrics.divergence import by_first_appearance
from gpusimbench.schemas.mixing import GOLDEN, mix


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
        """Which pairs differ, [step, pair]."""
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
        known = Splits(by_hashes, step_range(self.steps), self._equal.result(), no_classes=no_classes)
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
    """Of at least one step."""
    return StepRange(len(steps), steps[0], steps[-1])
