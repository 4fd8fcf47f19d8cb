"""What a comparison finds: one statement about one thing of one configuration."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from enum import Enum
from typing import Protocol

from gpusimbench.evaluator.results.metric import Axis, Direction
from gpusimbench.evaluator.statistics.families import fisher, least_fisher
from gpusimbench.schemas.errors import ExitCode

DEFAULT_GATES = frozenset({Axis.THROUGHPUT, Axis.MEMORY, Axis.PHYSICS, Axis.VALIDITY, Axis.DETERMINISM, Axis.EPISODES})


class Change(Enum):
    """What head is beside base.

    REGRESSION     worse
    IMPROVEMENT    better
    CHANGED        another, of which neither is better
    SMALL          another, by less than matters
    NEAR           another; whether by as much as matters, so many runs do not tell
    SAME           the same, for certain
    WITHIN         not shown to be another, and shown not to be by as much as matters
    UNCLEAR        not to be told apart by so many runs
    NOT_COMPARED   there is a reason why not
    """

    REGRESSION = "regression"
    IMPROVEMENT = "improvement"
    CHANGED = "changed"
    SMALL = "below threshold"
    NEAR = "near threshold"
    SAME = "same"
    WITHIN = "within threshold"
    UNCLEAR = "not distinguishable"
    NOT_COMPARED = "not compared"


def judged(direction: Direction, *, rises: bool) -> Change:
    """What a difference is that is large enough to matter."""
    if direction is Direction.NEITHER:
        return Change.CHANGED
    return Change.IMPROVEMENT if rises == (direction is Direction.HIGHER) else Change.REGRESSION


FAILING = frozenset({Change.REGRESSION, Change.CHANGED})
"""What fails a gate."""

DIFFERENT = FAILING | {Change.IMPROVEMENT, Change.SMALL, Change.NEAR}
"""What fails where both sets are said to be of one thing."""


@dataclass(frozen=True)
class Finding:
    """One statement.

    axis        that it belongs to
    name, title of what is compared, for programs and for people
    change      the verdict
    direction   which way is better
    unit        of base and head; "B" for bytes, empty for counts and words
    base, head  means over runs; None where words say it
    said        base and head in words; empty where the numbers say it
    ratio       head / base; None where there is none
    ci95        of the ratio, of this comparison alone; None where there is none
    difference_ci95  of head - base, in the unit, where differences are tested and not ratios
    bounded     whether the verdict is by an interval: of the ratio or difference, or of the amount where one is zero
    p_value     of this comparison alone; None where the verdict is no statistic
    p_adjusted  for all comparisons of the invocation (Holm); verdicts are by this one; None where so few runs could
                show nothing, whatever they had been
    least_p     the smallest p-value that so many runs can give
    n           runs of base and of head
    tested_on   what the test exchanges, of which there may be too few: "runs" or "environments"
    method      what is compared
    test        how it was tested; empty where nothing was
    note        what a reader must see beside it
    missing     why it is not compared
    applies     whether either side has such a thing; where neither has, there is nothing to decide
    left_open   changes as large as matters that these runs do not exclude; empty where the verdict stands
    drift       whether a drift of the machine may be all of the difference, for the sides were not recorded in turn
    """

    axis: Axis
    name: str
    title: str
    change: Change
    direction: Direction = Direction.NEITHER
    unit: str = ""
    base: float | None = None
    head: float | None = None
    said: tuple[str, str] = ("", "")
    ratio: float | None = None
    ci95: tuple[float, float] | None = None
    difference_ci95: tuple[float, float] | None = None
    bounded: bool = False
    p_value: float | None = None
    p_adjusted: float | None = None
    least_p: float | None = None
    n: tuple[int, int] = (0, 0)
    tested_on: str = "runs"
    method: str = ""
    test: str = ""
    note: str = ""
    missing: str = ""
    applies: bool = True
    left_open: tuple[Change, ...] = ()
    drift: bool = False

    def fails(self, settings: Settings) -> bool:
        """Whether it fails a gate."""
        if settings.expect_same:
            return self.change in DIFFERENT
        return self.axis in settings.gates and self.change in FAILING

    def undecided(self, settings: Settings) -> str:
        """Why its gate is neither failed nor passed; empty where it is decided, or where there is no gate."""
        if self.axis not in settings.gates or not self.applies or self.fails(settings):
            return ""
        if self.change is Change.NOT_COMPARED:
            return self.missing
        if not (set(self.left_open) & (DIFFERENT if settings.expect_same else FAILING)):
            return ""
        if self.bounded:
            return f"the interval contains a change of {settings.threshold * 100:.3g} % or more"
        return f"too few {self.tested_on}"


class Question(Protocol):
    """A test that is still to be made."""

    @property
    def least_p(self) -> float:
        """The smallest p-value that it can give, whatever the runs had been: known before it is made."""
        ...

    def __call__(self, level: float, *, able: bool) -> tuple[Finding, Finding]:
        """Two findings with its p-value: what is found where that is significant, and what where it is not.

        level  that one comparison of all has to reach
        able   whether the test can reach it, whatever the runs had been
        """
        ...


@dataclass(frozen=True)
class Settings:
    """What counts.

    alpha        chance of any false alarm among the statistical comparisons of an invocation
    threshold    smallest relative change that matters: 0.05 is a factor of 1.05, up or down
    outcome_cm   smallest change of where bodies end that matters [cm]; of joint angles as many hundredths of a radian
    gates        axes that decide
    expect_same  base and head are claimed to be one thing: every difference counts, whatever its axis and direction
    """

    alpha: float = 0.05
    threshold: float = 0.05
    outcome_cm: float = 0.01
    gates: frozenset[Axis] = DEFAULT_GATES
    expect_same: bool = False

    def least_outcome(self, unit: str) -> float:
        """Smallest change of where bodies or joints end that matters, in "cm" or "rad": 0.1 mm and 0.1 mrad."""
        return self.outcome_cm / 100.0 if unit == "rad" else self.outcome_cm

    def matters(self, one: float, other: float) -> bool:
        """Whether two positive amounts are apart by more than the threshold, whichever is taken for the other's."""
        low, high = sorted((one, other))
        return low <= 0 < high or (low > 0 and math.log(high / low) > math.log1p(self.threshold) * (1 + 1e-12))


def not_compared(axis: Axis, name: str, title: str, why: str, *, applies: bool = True) -> Finding:
    """A finding without a verdict, and the reason; `applies` is false where neither side has anything to compare."""
    return Finding(axis, name, title, Change.NOT_COMPARED, missing=why, applies=applies)


def either_way(tested: Finding, *, falls: bool, rises: bool, beyond: bool = False) -> tuple[Finding, Finding]:
    """Two findings: one for a significant p, one for a p that is not significant.

    falls, rises  whether the interval contains a decrease, or an increase, that matters
    beyond        whether the interval contains only changes that matter, all in one direction
    """
    ways = [way for way, held in ((False, falls), (True, rises)) if held]
    left = tuple(dict.fromkeys(judged(tested.direction, rises=way) for way in ways))
    not_shown = replace(tested, change=Change.UNCLEAR if left else Change.WITHIN, left_open=left)
    if beyond:
        return replace(tested, change=left[0]), not_shown
    return replace(tested, change=Change.NEAR if left else Change.SMALL, left_open=left), not_shown


@dataclass(frozen=True)
class Counted:
    """Whether the shares of the two sides differ, by Fisher's exact test.

    finding     with what it says if they do
    base, head  in how many runs, of how many
    of          which runs are counted, in words
    """

    finding: Finding
    base: tuple[int, int]
    head: tuple[int, int]
    of: str

    @property
    def least_p(self) -> float:
        """See Question."""
        return least_fisher(self.base[0] + self.head[0], self.base[1], self.head[1])

    def __call__(self, level: float, *, able: bool) -> tuple[Finding, Finding]:
        """See Question; the more uneven the runs fell, the smaller p, so that only the way they fell is left open."""
        found = replace(
            self.finding,
            p_value=fisher(self.base, self.head),
            least_p=self.least_p,
            test=f"Fisher's exact test of runs {self.of}",
        )
        even = self.base[0] * self.head[1] == self.head[0] * self.base[1]
        left = () if able or even else (found.change,)
        return found, replace(found, change=Change.UNCLEAR, left_open=left)


def exit_code_of(*, failing: bool, lost: bool, decided: bool) -> ExitCode:
    """The exit code of a comparison.

    failing  some finding fails a gate: that comes first, since what whole files show stands whatever others are
    lost     a recording could not be read, or lost data
    decided  something was compared, and no axis with a gate is left open
    """
    if failing:
        return ExitCode.GATE_FAILED
    if lost:
        return ExitCode.DATA_LOST
    return ExitCode.OK if decided else ExitCode.NOTHING_COMPARABLE
